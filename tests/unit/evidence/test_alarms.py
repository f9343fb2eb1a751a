"""Counting of clean flights that a check failed: intervals, seeds and reasons."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from evidence.alarms.case import SAMPLES, Case, by_estimate, by_event
from evidence.alarms.command import STATED, line, summary
from evidence.provenance import FIRST_FRESH


def test_the_interval_of_no_failure_is_the_rule_of_three() -> None:
    """(1 - p)^n = 0.05; the exact bound of Clopper and Pearson."""
    found = line(0, 1000, 1e-5)
    assert found["low"] == 0.0
    assert found["high"] == pytest.approx(1.0 - 0.05 ** (1.0 / 1000))
    assert not found["beyond"]
    assert line(1, 100, 1e-5)["beyond"]
    assert line(3, 3, 1e-5)["high"] == 1.0


def test_a_seed_follows_from_the_commit_and_the_flight() -> None:
    seeds = {Case(SAMPLES, "base", k, own).seed for k in range(50) for own in ("a1", "b2")}
    assert len(seeds) == 100
    assert min(seeds) >= FIRST_FRESH
    assert Case(SAMPLES, "base", 3, "a1").seed == Case(SAMPLES, "base", 3, "a1").seed


def test_a_reason_before_the_first_valid_output_is_no_alarm() -> None:
    reasons = ("MODEL_MISMATCH", "", "MODEL_MISMATCH", "NOT_CONSISTENT", "")
    published = [SimpleNamespace(valid=not r, reason=r, gated=2) for r in reasons]
    fired = by_estimate(cast(Any, published), 1)
    assert fired == {"gate": 2, "sensor": 1, "mismatch": 1, "consistency": 1}
    assert by_event(["CHANGE_DETECTED", "CONTACT", "CHANGE_DETECTED"]) == {
        "change": 2,
        "outside": 1,
        "prior": 0,
        "level": 0,
        "creep": 0,
        "reset": 0,
    }


def test_the_summary_counts_flights_not_firings() -> None:
    fired = dict.fromkeys(STATED, 0) | {"gate": 7}
    clean = {"level": SAMPLES, "scenario": "base", "seed": 1, "valid": True, "wrong": 0}
    rows = [clean | {"reason": "", "fired": own} for own in (fired, {"gate": 0})]
    found = summary(rows)
    assert found["checks"]["gate"]["failed"] == 1
    assert found["checks"]["gate"]["flights"] == 2
    assert found["checks"]["sample"]["flights"] == 1, "the other flight does not show it"
    assert [flight["seed"] for flight in found["failed"]] == [1]
