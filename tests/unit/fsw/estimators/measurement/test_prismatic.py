"""A prismatic joint: closed form, derivatives, another engine, recovery without noise."""

import numpy as np

from fsw.estimators.batch.run import run_batch
from fsw.estimators.measurement.fused import predict
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.robot import RobotModel
from hil.world.spline import JointSpline
from hil.world.truth import Robot, simulate
from tests.support.estimator_cases import (
    BASE,
    HIL,
    TARGET,
    parameters,
    random_block,
    true_block,
    wrong,
)
from tests.support.sliding import JOINT, sliding_config, sliding_urdf

RAIL = """<robot name="rail"><link name="bus"><inertial><mass value="30"/>
<inertia ixx="4" ixy="0" ixz="0" iyy="5" iyz="0" izz="6"/></inertial></link>
<joint name="rail" type="prismatic"><parent link="bus"/><child link="car"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="50" velocity="0.5"/></joint>
<link name="car"><inertial><mass value="10"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link></robot>"""


def test_two_masses_that_push_each_other_have_the_closed_form(tmp_path):
    """Along one line: a_base = -m a / (M + m), force = M m a / (M + m)."""
    path = tmp_path / "rail.urdf"
    path.write_text(RAIL)
    model = RobotModel(path, "car")
    assert model.kinds() == ("prismatic",)
    M, m, a = 30.0, 10.0, 0.7
    acceleration = np.array([0.0, 0.0, -m * a / (M + m), 0.0, 0.0, 0.0, a])
    still = np.zeros(1)
    force = model.regressor(np.array([0.4]), np.zeros(3), still, acceleration) @ model.pi_links
    np.testing.assert_allclose(force, [0, 0, 0, 0, 0, 0, M * m * a / (M + m)], atol=1e-12)


def test_derivatives_by_state_and_by_the_motion_of_the_joint(tmp_path):
    config = sliding_config(tmp_path, ("base", "target"), doubt=True, momentum_sigma_nms=1.0)
    problem = build_problem(config, RobotModel(config.robot.urdf, "tool"))
    x, block = problem.prior_mean.copy(), random_block(2)
    prediction = predict(block, x, problem)

    def channels(state: np.ndarray) -> np.ndarray:
        p = predict(block, state, problem)
        return np.concatenate([p.tau_nm, p.f_m_s2, p.w_rad_s], axis=1)

    for k, name in enumerate(problem.names):
        d = np.zeros_like(x)
        d[k] = 1e-4 * max(1.0, abs(x[k]))
        expected = (channels(x + d) - channels(x - d)) / (2.0 * d[k])
        rounding = 1e-13 * np.abs(channels(x)).max() / d[k]
        got = prediction.J[:, :, k]
        assert np.abs(got - expected).max() <= 1e-6 * np.abs(expected).max() + rounding, name


def test_another_engine_and_recovery_from_a_wrong_prior_without_noise(tmp_path):
    urdf = sliding_urdf(tmp_path)
    spline = JointSpline.load(HIL / "trajectories" / "target_leo_identification.yaml")
    truth = simulate(Robot.load(urdf, "tool", base=BASE, target=TARGET), spline, 0.0, 24.0, 0.005)
    blocks = [true_block(truth, 0.4 * k, k) for k in range(58)]
    assert np.ptp([block.q_rad[:, JOINT] for block in blocks]) > 0.1  # it slides
    config = sliding_config(tmp_path, ("target",), biases=False)
    problem = build_problem(config, RobotModel(urdf, "tool"))
    at_truth = predict(blocks[30], parameters(TARGET), problem)
    assert np.abs(at_truth.tau_nm - blocks[30].tau_nm).max() < 1e-4 * np.abs(at_truth.tau_nm).max()
    far = wrong(TARGET, np.random.default_rng(4))
    config = sliding_config(tmp_path, ("target",), target=far, biases=False)
    found = run_batch(config, blocks, "fused", ())
    sigma = np.sqrt(np.diag(np.array(found["covariance"])))[:10]
    assert np.all(np.abs(np.array(found["mean"])[:10] - parameters(TARGET)) < 0.05 * sigma)
