"""A control-moment gyro is two joints of the tree: a gimbal on the base, a wheel on the gimbal."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from fsw.config import Config
from fsw.estimators.batch.run import run_batch
from fsw.estimators.measurement.fused import predict
from fsw.estimators.model.problem import build_problem
from fsw.estimators.model.robot import RobotModel
from fsw.messages import Block
from hil.world.spline import JointSpline
from hil.world.truth import Robot, simulate
from tests.support.estimator_cases import (
    BASE,
    HIL,
    TARGET,
    URDF,
    Body,
    covariances,
    make_config,
    parameters,
    true_block,
    wrong,
)

AXIAL_KG_M2, SPIN_RAD_S, SWING_RAD_S = 0.05, 100.0, 0.2
BLOCKS, SEEDS = 58, 6
GYRO = """<joint name="a_gimbal" type="revolute"><parent link="{root}"/><child link="cage"/>
<origin xyz="0.2 -0.1 0.3"/><axis xyz="1 0 0"/>
<limit lower="-3" upper="3" effort="20" velocity="1"/></joint>
<link name="cage"><inertial><mass value="2"/>
<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>
<joint name="a_rotor" type="revolute"><parent link="cage"/><child link="rotor"/>
<axis xyz="0 0 1"/><limit lower="-1e6" upper="1e6" effort="5" velocity="400"/></joint>
<link name="rotor"><inertial><mass value="6"/>
<inertia ixx="0.03" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="{axial}"/></inertial></link></robot>"""


def with_gyro(folder: Path) -> Path:
    text = URDF.read_text()
    root = RobotModel(URDF, "tool").model.frames[2].name
    assert f'<link name="{root}">' in text
    path = folder / "gyro.urdf"
    path.write_text(text.replace("</robot>", GYRO.format(root=root, axial=AXIAL_KG_M2)))
    return path


def config_of(urdf: Path, target: Body = TARGET) -> Config:
    """Return a configuration whose two more joints have encoders and no torque sensors."""
    data = make_config(("target",), target=target, biases=False).model_dump()
    data["robot"]["urdf"] = str(urdf)
    more = {"bus": "arm", "torque": "none", "position_noise_rad": 1e-6, "zero_sigma_rad": 0.0}
    data["joints"] = [
        *data["joints"],
        {"name": "a_gimbal", "node_id": 0x21, "speed_limit_rad_s": 1.0, **more},
        {"name": "a_rotor", "node_id": 0x22, "speed_limit_rad_s": 400.0, **more},
    ]
    return Config.model_validate(data)


@pytest.fixture(scope="module")
def urdf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return with_gyro(tmp_path_factory.mktemp("gyro"))


@lru_cache(maxsize=1)
def blocks_of(urdf: Path) -> list[Block]:
    """Return noise-free windows: the arm moves, the wheel runs up, then its gimbal swings."""
    arm = JointSpline.load(HIL / "trajectories" / "target_leo_identification.yaml")
    robot = Robot.load(urdf, "tool", base=BASE, target=TARGET)
    knots = np.arange(len(arm.control_points_rad)) * arm.knot_spacing_s
    run = np.clip(knots, knots[3], knots[-4]) - knots[3]
    own = {
        "a_gimbal": SWING_RAD_S / 0.6 * (1.0 - np.cos(0.6 * run)),
        "a_rotor": SPIN_RAD_S * run,
    }
    order = [f"joint{k + 1}" for k in range(7)]
    columns = [
        own[name] if name in own else arm.control_points_rad[:, order.index(name)]
        for name in robot.joint_names
    ]
    spline = JointSpline(arm.duration_s, np.stack(columns, axis=1))
    truth = simulate(robot, spline, -1.0, 0.4 * BLOCKS + 1.0, 0.0025)
    cov, count = covariances(), robot.n
    stacked = {key: np.stack([cov[key][0]] * count) for key in ("cov_joint", "cov_tau")}
    has = np.array([name not in own for name in robot.joint_names])
    return [replace(true_block(truth, 0.4 * k, k), **stacked, has_joint=has) for k in range(BLOCKS)]


def noisy(block: Block, rng: np.random.Generator) -> Block:
    m = len(block.t_ns)

    def drawn(covariance: np.ndarray, columns: int) -> np.ndarray:
        values, vectors = np.linalg.eigh(covariance)
        return vectors @ (
            np.sqrt(np.maximum(values, 0.0))[:, None] * rng.normal(size=(len(covariance), columns))
        )

    joints = drawn(block.cov_joint[0], block.q_rad.shape[1])
    gyro = drawn(block.cov_gyro, 3)
    return replace(
        block,
        qd_rad_s=block.qd_rad_s + joints[:m],
        qdd_rad_s2=block.qdd_rad_s2 + joints[m:],
        tau_nm=block.tau_nm + drawn(block.cov_tau[0], block.q_rad.shape[1]),
        w_NB_B_rad_s=block.w_NB_B_rad_s + gyro[:m],
        wd_NB_B_rad_s2=block.wd_NB_B_rad_s2 + gyro[m:],
        f_NS_B_m_s2=block.f_NS_B_m_s2 + drawn(block.cov_acc, 3),
    )


def test_the_gimbal_s_rate_turns_the_momentum_of_the_wheel(urdf):
    """Moment that holds the base: w x h, w = rate x, h = axial inertia x spin x z: along -y."""
    model = RobotModel(urdf, "tool")
    qd = np.zeros(model.n)
    gimbal, rotor = model.joint_names.index("a_gimbal"), model.joint_names.index("a_rotor")

    def moment(rate: float, spin: float) -> np.ndarray:
        qd[[gimbal, rotor]] = rate, spin
        Y = model.regressor(np.zeros(model.n), np.zeros(3), qd, np.zeros(6 + model.n))
        return np.asarray(Y @ model.pi_links)[3:6]

    h = AXIAL_KG_M2 * SPIN_RAD_S
    got = moment(SWING_RAD_S, SPIN_RAD_S) - moment(SWING_RAD_S, 0.0)
    np.testing.assert_allclose(got, np.cross([SWING_RAD_S, 0, 0], [0, 0, h]), atol=1e-12)


def test_another_engine_and_recovery_without_noise(urdf):
    blocks = blocks_of(urdf)
    config = config_of(urdf)
    problem = build_problem(config, RobotModel(urdf, "tool"))
    at = predict(blocks[40], parameters(TARGET), problem)
    use = blocks[40].has_joint
    assert np.abs(at.tau_nm - blocks[40].tau_nm)[:, use].max() < 1e-3
    assert np.abs(at.w_rad_s - blocks[40].w_NB_B_rad_s).max() < 1e-6
    far = wrong(TARGET, np.random.default_rng(4))
    found = run_batch(config_of(urdf, far), blocks, "fused", ())
    sigma = np.sqrt(np.diag(np.array(found["covariance"])))[:10]
    assert np.all(np.abs(np.array(found["mean"])[:10] - parameters(TARGET)) < 0.1 * sigma)


def test_the_error_with_noise_is_what_the_covariance_says(urdf):
    nees = []
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        far = wrong(TARGET, rng)
        blocks = [noisy(block, rng) for block in blocks_of(urdf)]
        found = run_batch(config_of(urdf, far), blocks, "fused", ())
        error = np.array(found["mean"])[:10] - parameters(TARGET)
        nees.append(error @ np.linalg.solve(np.array(found["covariance"])[:10, :10], error))
    low, high = chi2.ppf([0.005, 0.995], 10 * SEEDS) / SEEDS
    assert low < np.mean(nees) < high, nees
