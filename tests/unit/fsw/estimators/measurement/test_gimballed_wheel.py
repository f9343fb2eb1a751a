"""A control-moment gyro is two joints of the tree: a gimbal on the base, a wheel on the gimbal."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from fsw.config import Config
from fsw.estimators.batch.run import run_batch
from fsw.estimators.measurement.fused import predict
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.robot import RobotModel
from fsw.messages import Block
from hil.world.spline import JointSpline
from hil.world.truth import Robot, simulate
from tests.support.estimator_cases import (
    BASE,
    HIL,
    TARGET,
    Body,
    covariances,
    make_config,
    parameters,
    true_block,
    wrong,
)
from tests.support.gimballed import AXIAL_KG_M2, GYRO_JOINTS, with_gyro, with_run_up

SPIN_RAD_S, SWING_RAD_S = 100.0, 0.2
BLOCKS, SEEDS = 58, 6


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
    spline = with_run_up(arm, robot.joint_names, SPIN_RAD_S, SWING_RAD_S)
    truth = simulate(robot, spline, -1.0, 0.4 * BLOCKS + 1.0, 0.0025)
    cov, count = covariances(), robot.n
    stacked = {key: np.stack([cov[key][0]] * count) for key in ("cov_joint", "cov_tau")}
    has = np.array([name not in GYRO_JOINTS for name in robot.joint_names])
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
        qdd_rad_s2=block.qdd_rad_s2 + joints[m : 2 * m],
        q_rad=block.q_rad + joints[2 * m :],
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
