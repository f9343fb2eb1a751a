"""The correlation of mission elapsed time with UTC, as it goes down."""

from datetime import UTC, datetime

import pytest

from fsw.clock import UNKNOWN_ERROR_NS, utc_correlation
from fsw.service.process import _epoch
from fsw.telemetry.services.time_reports import correlation_values
from fsw.telemetry.state.epoch import Epoch
from tests.support.application_cases import SECOND, Flight

NOON = 1_795_348_800 * SECOND  # 2026-11-22T12:00:00Z


def test_utc_of_a_packet_is_the_epoch_and_its_time():
    epoch = Epoch(
        clock_id="a", utc_less_met_ns=NOON - 100 * SECOND, uncertainty_ns=5000, synchronised=True
    )
    found = correlation_values(epoch, 100 * SECOND)
    assert found["utc_unix_ns"] == NOON
    assert found["epoch_utc"] == "2026-11-22T11:58:20.000000Z"
    assert found["uncertainty_s"] == pytest.approx(5060e-9)
    assert found["synchronised"] is True


def test_every_time_packet_is_followed_by_a_correlation_of_its_own_time(flight: Flight):
    flight.send("SET_TIME_REPORT_RATE", {"exponent": 0})
    before = len(flight.packets)
    flight.wait(3.0)
    names = ("time", "time_correlation")
    new = [p for p in flight.packets[before:] if p.packet.name in names]
    assert [p.packet.name for p in new] == list(names) * (len(new) // 2)
    assert len(new) >= 4
    for told in new[1::2]:
        expected = told.t_ns + flight.app.context.epoch().utc_less_met_ns
        assert abs(told.values["utc_unix_ns"] - expected) <= 60  # the stamp's last bit


def test_the_machines_clocks_are_read_together_with_a_bound_of_the_error():
    known = utc_correlation()
    assert known.uncertainty_ns > 0
    assert known.synchronised or known.uncertainty_ns >= 0.9 * UNKNOWN_ERROR_NS
    epoch = _epoch("boot")
    apart_ns = abs(epoch.utc_less_met_ns - known.utc_less_monotonic_ns)
    assert apart_ns <= known.uncertainty_ns + epoch.uncertainty_ns
    year = datetime.fromtimestamp(correlation_values(epoch, 0)["utc_unix_ns"] * 1e-9, UTC).year
    assert year >= 2024
