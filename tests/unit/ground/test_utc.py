"""Dates of packets by the correlation the daemon sends."""

import math

import pytest

from ground.telemetry import Sample
from ground.utc import Correlation

NOON = 1_795_348_800  # 2026-11-22T12:00:00Z


def correlation(time_s: float, utc_s: int, synchronised: str = "YES") -> Sample:
    values = {"utc_unix_ns": utc_s * 10**9, "uncertainty_s": 0.01, "synchronised": synchronised}
    return Sample(packet="time_correlation", service=9, subtype=128, time_s=time_s, values=values)


def test_without_a_correlation_there_is_no_date():
    dates = Correlation()
    dates.take(Sample(packet="health", service=3, subtype=25, time_s=1.0, values={}))
    assert dates.date(1.0) is None
    assert dates.text(1.0) is None


def test_a_packet_gets_its_date_and_one_without_time_none():
    dates = Correlation()
    dates.take(correlation(100.0, NOON))
    assert dates.text(101.25) == "2026-11-22T12:00:01.250Z"
    assert dates.date(math.nan) is None
    assert dates.uncertainty_s == pytest.approx(0.01)


def test_the_newest_correlation_counts():
    dates = Correlation()
    dates.take(correlation(100.0, NOON))
    dates.take(correlation(200.0, NOON + 160, "NO"))
    assert dates.text(200.0) == "2026-11-22T12:02:40.000Z"
    assert not dates.synchronised
