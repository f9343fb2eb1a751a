"""Drives of dialects, encoded independently of the flight software, which reads them described."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hil.judge import judgement
from hil.run import bench
from hil.world.scenario import ScenarioError
from tests.support.short_cases import NoMeter, short

DIALECTS = ("cyclic", "cia402", "packed", "clocked")
TOP_999 = 29.6  # of a chi-squared value with 10 degrees of freedom
RATE_HZ = 100.0


def prepared(folder: Path, dialect: str, *, real_time: bool = False) -> bench.Setup:
    scenario = short(folder, points=8, rate_hz=RATE_HZ)
    joints = scenario.sensors["joints"] | {"dialect": dialect}
    scenario = replace(scenario, sensors=scenario.sensors | {"joints": joints})
    return bench.prepare(scenario, 1, folder, real_time=real_time)


@pytest.mark.parametrize("dialect", DIALECTS)
def test_the_target_is_found_by_drives_of_a_dialect(tmp_path, dialect):
    setup = prepared(tmp_path, dialect)
    recorded = bench.run_virtual(setup, NoMeter(), record=False)
    counts = recorded.status["samples"][setup.config.buses[0].name]
    assert (counts["rejected"], counts["lost"]) == (0, 0), counts
    expected = RATE_HZ * setup.total_s * len(setup.config.joints)
    assert counts["accepted"] == pytest.approx(expected, rel=0.01)
    assert not [event for event in recorded.events if event.severity in ("medium", "high")]
    outcome: dict[str, Any] = judgement.judge(setup, judgement.make_case(setup), recorded)
    assert outcome["valid"], outcome["reason"]
    assert outcome["nees"] < TOP_999


@pytest.mark.parametrize("dialect", ["cia402", "clocked"])
def test_drives_with_a_time_of_their_own_fly_in_real_time(tmp_path, dialect):
    setup = prepared(tmp_path, dialect, real_time=True)
    recorded = bench.run_live(setup, NoMeter())
    outcome: dict[str, Any] = judgement.judge(setup, judgement.make_case(setup), recorded)
    counts = recorded.status["samples"][setup.config.buses[0].name]
    assert outcome["valid"], (outcome["reason"], counts)
    assert outcome["nees"] < TOP_999
    assert counts["accepted"] > 0.95 * RATE_HZ * setup.total_s * len(setup.config.joints)
    assert recorded.extra["replay_difference_sigma"] == 0.0


def test_a_dialect_that_does_not_exist_is_named(tmp_path):
    with pytest.raises(ScenarioError, match="'klingon' must be one of cia402, clocked, cyclic"):
        prepared(tmp_path, "klingon")
