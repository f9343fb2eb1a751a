"""Drives that send by timers of their own, read by description: no SYNC, no counter, no time."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.judge import judgement
from hil.run import bench
from hil.world.scenario import ScenarioError
from tests.support.short_cases import NoMeter, short

SEEDS = (1,)
TOP_999 = 29.6  # of a chi-squared value with 10 degrees of freedom
RATE_HZ = 100.0


def flown(folder: Path, seed: int, *, real_time: bool = False) -> dict[str, Any]:
    scenario = short(folder, points=8, rate_hz=RATE_HZ)
    joints = dict(scenario.sensors["joints"])
    joints["nodes"] = [
        node | {"format": "cyclic", "node_id": k} for k, node in enumerate(joints["nodes"])
    ]
    scenario = replace(scenario, sensors=scenario.sensors | {"joints": joints})
    setup = bench.prepare(scenario, seed, folder, real_time=real_time)
    assert setup.config.buses[0].listen_only
    recorded = bench.run_virtual(setup, NoMeter(), record=False)
    counts = recorded.status["samples"][setup.config.buses[0].name]
    assert (counts["rejected"], counts["lost"]) == (0, 0)
    expected = RATE_HZ * setup.total_s * len(setup.config.joints)
    assert counts["accepted"] == pytest.approx(expected, rel=0.01)
    assert not [event for event in recorded.events if event.severity in ("medium", "high")]
    return judgement.judge(setup, judgement.make_case(setup), recorded)


def test_the_target_is_found_by_drives_without_sync(tmp_path):
    outcomes = [flown(tmp_path, seed) for seed in SEEDS]
    assert all(outcome["valid"] for outcome in outcomes), [o["reason"] for o in outcomes]
    assert np.mean([outcome["nees"] for outcome in outcomes]) < TOP_999


def test_such_drives_need_virtual_time(tmp_path):
    with pytest.raises(ScenarioError, match="cyclic needs virtual time"):
        flown(tmp_path, 1, real_time=True)
