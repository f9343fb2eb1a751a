"""Samples of an arm on a rail and of joints that wrap, through `fsw import` and `fsw identify`.

Truth is Pinocchio's inverse dynamics of the URDF with a body at the tool, beside the closed form of
the rail's force. Bounds, set before the first run: mass within 3 of its sigma, and sigma at most a
tenth of the prior's. The links are exact here, and the configuration says so.
"""

import json
from math import pi, tau
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml

from fsw.__main__ import main
from tests.support.import_cases import SAMPLES_HZ, Import, robot

MASS_KG, COM_M, PRIOR_SIGMA_KG = 2.6, np.array([0.02, -0.01, 0.08]), 1.0
T = np.arange(1800) / SAMPLES_HZ
UNITS = {"revolute": ("rad", "N m"), "prismatic": ("m", "N")}


def motion(turns: float) -> tuple[np.ndarray, ...]:
    """Return positions, rates and accelerations (k, 2); the first joint also turns on and on."""
    w, a = np.array([[0.9, 1.7], [1.1, 2.3]]), np.array([[0.3, 0.15], [0.4, 0.1]])
    phase = T[:, None, None] * w
    q = (a * np.sin(phase)).sum(axis=2)
    q[:, 0] += turns * T
    return q, (a * w * np.cos(phase)).sum(axis=2), -(a * w**2 * np.sin(phase)).sum(axis=2)


def measured(folder: Path, turns: float) -> np.ndarray:
    """Return times, positions and torques as sensors give them (k, 5)."""
    model = pin.buildModelFromUrdf(str(folder / "arm.urdf"))
    tool = model.frames[model.getFrameId("tool0")]
    body = pin.Inertia(MASS_KG, COM_M, np.diag([0.02, 0.02, 0.01]))
    model.appendBodyToJoint(tool.parentJoint, body, tool.placement)
    data = model.createData()
    q, v, a = motion(turns)
    v[:, 0] += turns
    rows = zip(q, v, a, strict=True)
    torque = np.array([pin.rnea(model, data, *row) for row in rows])
    rng = np.random.default_rng(5)
    noisy = torque + rng.normal(0, 0.025, torque.shape)
    return np.column_stack([T, q + rng.normal(0, 1e-5, q.shape), noisy])


def identified(arm: Import, values: np.ndarray, mapping: dict, capsys) -> dict:
    names = ["t", "q_j1", "q_j2", "tau_j1", "tau_j2"]
    rows = [",".join(map(repr, row)) for row in values.tolist()]
    (arm.folder / "a.csv").write_text("\n".join([",".join(names), *rows]) + "\n")
    assert arm.table(arm.folder / "a.csv", mapping, "--force") == 0, arm.refused
    main(["identify", str(arm.out), "--config", str(arm.folder / "robot.yaml"), "--json"])
    return json.loads(capsys.readouterr().out)


def mapping(kinds: tuple[str, str]) -> dict:
    return {
        "joints": {
            "time": {"column": "t", "unit": "s"},
            "position": {"columns": "q_{}", "unit": [UNITS[kind][0] for kind in kinds]},
            "torque": {"columns": "tau_{}", "unit": [UNITS[kind][1] for kind in kinds]},
        }
    }


def strong(folder: Path, kinds: tuple[str, str]) -> None:
    """Write the robot with limits that its own weight keeps, and links that are exact."""
    path = robot(folder, sampled=True, kinds=kinds)
    data = yaml.safe_load(path.read_text())
    data["robot"]["links_sigma_ratio"] = 0
    for joint in data["joints"]:
        key = "torque_limit_nm" if joint["kind"] == "revolute" else "force_limit_n"
        joint[key] = 500
        joint["speed_limit_rad_s" if joint["kind"] == "revolute" else "speed_limit_m_s"] = 3
    path.write_text(yaml.safe_dump(data))


def test_the_mass_moved_by_a_rail_is_found_in_metres_and_newtons(tmp_path, capsys):
    kinds = ("prismatic", "revolute")
    strong(tmp_path, kinds)
    values = measured(tmp_path, 0.0)
    weight_n = (2 * 2 + MASS_KG) * 9.80665  # two links and the body hang on the rail
    assert values[:, 3].mean() == pytest.approx(weight_n, rel=0.02)
    result = identified(Import(tmp_path, capsys), values, mapping(kinds), capsys)
    mass, sigma = (result[key]["target"]["mass_kg"] for key in ("estimate", "sigma"))
    assert abs(mass - MASS_KG) < 3.0 * sigma
    assert sigma < 0.1 * PRIOR_SIGMA_KG
    assert result["status"] != "MODEL_MISMATCH"


def test_wrapped_angles_give_what_the_angles_themselves_give(tmp_path, capsys):
    kinds = ("revolute", "revolute")
    strong(tmp_path, kinds)
    values = measured(tmp_path, 0.5)
    arm = Import(tmp_path, capsys)
    plain = identified(arm, values, mapping(kinds), capsys)
    values[:, 1] = (values[:, 1] + pi) % tau - pi
    assert (np.abs(np.diff(values[:, 1])) > pi).sum() > 3
    wrapped = identified(arm, values, mapping(kinds), capsys)
    assert wrapped["status"] == plain["status"] != "MODEL_MISMATCH"
    sigma = np.sqrt(np.diag(plain["covariance"]))
    assert np.abs((np.array(wrapped["mean"]) - plain["mean"]) / sigma).max() < 1e-3


def test_metres_of_a_rail_read_as_millimetres_are_named(tmp_path, capsys):
    kinds = ("prismatic", "revolute")
    strong(tmp_path, kinds)
    told = mapping(kinds)
    told["joints"]["position"]["unit"] = ["mm", "rad"]
    arm = Import(tmp_path, capsys)
    result = identified(arm, measured(tmp_path, 0.0), told, capsys)
    assert result["status"] == "MODEL_MISMATCH"
    assert main(["check", str(tmp_path / "robot.yaml"), str(arm.out)]) == 1
    said = capsys.readouterr().out
    assert "WRONG: joints: the positions of prismatic joints are in m, not in mm" in said


@pytest.mark.parametrize("unit", ["rad", "deg"])
def test_degrees_that_pass_every_limit_of_speed_are_named(unit, tmp_path, capsys):
    """An arm that creeps about 60 and 25 degrees; its URDF allows 9 rad."""
    kinds = ("revolute", "revolute")
    strong(tmp_path, kinds)
    values = measured(tmp_path, 0.0)
    values[:, 1] = 60.0 + np.sin(0.3 * T)
    values[:, 2] = 25.0 + np.sin(0.5 * T)
    rows = [",".join(map(repr, row)) for row in values.tolist()]
    (tmp_path / "a.csv").write_text("\n".join(["t,q_j1,q_j2,tau_j1,tau_j2", *rows]) + "\n")
    arm, told = Import(tmp_path, capsys), mapping(kinds)
    told["joints"]["position"]["unit"] = unit
    assert arm.table(tmp_path / "a.csv", told) == 0, arm.refused
    limits = "the limits in arm.urdf are -9 to 9 rad"
    assert arm.said.count(limits) == (2 if unit == "rad" else 0)
    asked = arm.said.partition(limits)[2].count("is the unit in the mapping right (rad or deg")
    assert asked == (1 if unit == "rad" else 0), "once, after all columns"
