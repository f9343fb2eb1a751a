"""A control-moment gyro from device bytes: two joints without torque sensors, NEES in its band."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fsw.estimators.model.robot import RobotModel
from hil.judge import judgement
from hil.run import bench
from hil.world.spline import JointSpline
from tests.support.gimballed import AXIAL_KG_M2, GYRO_JOINTS, with_gyro, with_run_up
from tests.support.short_cases import NoMeter, short

SEEDS = (1, 2, 3)
BAND_999 = (3.3, 20.3)  # mean of three chi-squared values with 10 degrees of freedom
SPIN_RAD_S, SWING_RAD_S = 45.0, 0.2  # within the 128 revolutions of an angle of 32 bits
FAST_RAD_S = 400.0


def prepared(folder: Path, seed: int) -> bench.Setup:
    """Return a short flight in which the wheel runs up and its gimbal swings."""
    scenario = short(folder, points=8)
    urdf = with_gyro(folder)
    names = RobotModel(urdf, "tool").joint_names
    motions = {}
    for kind, spin, swing in (("identification", SPIN_RAD_S, SWING_RAD_S), ("verification", 0, 0)):
        arm = JointSpline.load(getattr(scenario, kind))
        motions[kind] = folder / f"{kind}.yaml"
        with_run_up(arm, names, spin, swing).save(motions[kind])
    joints = dict(scenario.sensors["joints"])
    arm_nodes = iter(joints["nodes"])
    joints["nodes"] = [
        {"node_id": 0x21 + GYRO_JOINTS.index(name), "torque_sensor": False}
        if name in GYRO_JOINTS
        else next(arm_nodes)
        for name in names
    ]
    scenario = replace(
        scenario,
        **motions,
        urdf=urdf,
        sensors=scenario.sensors | {"joints": joints},
        flight=scenario.flight | {"speed_limit_rad_s": FAST_RAD_S},
    )
    return bench.prepare(scenario, seed, folder)


def flown(setup: bench.Setup) -> dict[str, Any]:
    recorded = bench.run_virtual(setup, NoMeter(), record=False)
    return judgement.judge(setup, judgement.make_case(setup), recorded)


def test_the_target_is_found_while_a_gyro_turns_the_base(tmp_path):
    outcomes = []
    for seed in SEEDS:
        setup = prepared(tmp_path, seed)
        blind = [joint.name for joint in setup.config.joints if joint.torque == "none"]
        assert blind == list(GYRO_JOINTS)
        outcomes.append(flown(setup))
    assert all(outcome["valid"] for outcome in outcomes), [o["reason"] for o in outcomes]
    assert BAND_999[0] < np.mean([outcome["nees"] for outcome in outcomes]) < BAND_999[1]


def test_a_gyro_of_another_inertia_than_told_gives_no_valid_estimate(tmp_path):
    """Its momentum matters: the wheel has a third of the axial inertia that is told."""
    setup = prepared(tmp_path, SEEDS[0])
    told = tmp_path / "told.urdf"
    text = Path(setup.scenario.urdf).read_text()
    assert text.count(f'izz="{AXIAL_KG_M2}"') == 1
    told.write_text(text.replace(f'izz="{AXIAL_KG_M2}"', f'izz="{3.0 * AXIAL_KG_M2}"'))
    robot = setup.config.robot.model_copy(update={"urdf": told})
    config = setup.config.model_copy(update={"robot": robot})
    outcome = flown(replace(setup, config=config))
    assert not outcome["valid"], outcome["nees"]
