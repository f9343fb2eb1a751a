"""A prismatic joint from device bytes: metres and newtons on the wire, NEES within its band."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hil.judge import judgement
from hil.run import bench
from tests.support.short_cases import NoMeter, short
from tests.support.sliding import JOINT, sliding_urdf

SEEDS = (1, 2, 3)
BAND_999 = (3.3, 20.3)  # mean of three chi-squared values with 10 degrees of freedom


def flown(folder: Path, seed: int, form: str = "classic") -> dict[str, Any]:
    scenario = short(folder, points=8)
    joints = dict(scenario.sensors["joints"])
    joints["nodes"] = [node | {"format": form} for node in joints["nodes"]]
    sensors = scenario.sensors | {"joints": joints}
    scenario = replace(scenario, urdf=sliding_urdf(folder), sensors=sensors)
    setup = bench.prepare(scenario, seed, folder)
    assert setup.config.joints[JOINT].kind == "prismatic"
    recorded = bench.run_virtual(setup, NoMeter(), record=False)
    return judgement.judge(setup, judgement.make_case(setup), recorded)


def test_the_target_behind_a_sliding_joint_is_found(tmp_path):
    outcomes = [flown(tmp_path, seed) for seed in SEEDS]
    assert all(outcome["valid"] for outcome in outcomes), [o["reason"] for o in outcomes]
    assert BAND_999[0] < np.mean([outcome["nees"] for outcome in outcomes]) < BAND_999[1]


def test_nodes_of_can_fd_too(tmp_path):
    outcome = flown(tmp_path, 1, "fd")
    assert outcome["valid"], outcome["reason"]
    assert outcome["nees"] < 29.6
