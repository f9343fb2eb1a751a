"""End-effector error: zero for the true model, and right for a model known in closed form."""

import numpy as np
import pinocchio as pin
import pytest

from hil.judge.endeffector import Verification, exponential, rotation_angle

DURATION_S = 6.0


@pytest.fixture
def truth(small_bodies):
    return np.concatenate([small_bodies["base"], small_bodies["target"]])


@pytest.fixture
def motion(swing):
    return lambda t: swing(t)[:2]


@pytest.fixture
def verification(small_robot, motion):
    return Verification(small_robot("base", "target"), motion, DURATION_S)


def test_the_true_model_has_no_error(verification, truth):
    error = verification.error(truth, truth).summary()
    assert max(error.values()) == 0.0


def test_scaling_every_mass_changes_nothing(small_robot, motion, truth):
    # zero-momentum motion is homogeneous in the parameters
    robot = small_robot("base", "target")
    double = small_robot("base", "target")
    double.known = 2.0 * robot.known
    poses = Verification(robot, motion, DURATION_S).tool_path(truth)
    scaled = Verification(double, motion, DURATION_S).tool_path(2.0 * truth)
    np.testing.assert_allclose(poses[1], scaled[1], atol=1e-12)


def test_an_infinite_base_stays_where_it_is(verification, small_robot, motion, truth):
    heavy = truth.copy()
    heavy[:10] *= 1e9
    R, p = verification.tool_path(heavy)
    robot = small_robot()
    for k, t in enumerate(verification.t_s):
        R_BE, p_BE = robot.tool_pose(motion(np.array([t]))[0][0])
        np.testing.assert_allclose(p[0, k], p_BE, atol=1e-6)
        np.testing.assert_allclose(R[0, k], R_BE, atol=1e-6)


def test_integration_agrees_with_pinocchio(verification, small_robot, motion, truth):
    # an independent path: momentum from Pinocchio's centroidal map, fine midpoint rule
    robot = small_robot("base", "target")
    pi = robot.stacked(truth)
    model = robot.model.copy()
    for joint in range(1, model.njoints):
        model.inertias[joint] = pin.Inertia.FromDynamicParameters(pi[10 * (joint - 1) : 10 * joint])
    data = model.createData()
    steps = 6000
    h = DURATION_S / steps
    grid = np.linspace(0, DURATION_S, 2 * steps + 1)
    q_all, qd_all = motion(grid)
    q = pin.neutral(model)
    for k in range(steps):
        q[7:], qd = q_all[2 * k + 1], qd_all[2 * k + 1]  # midpoint rule, order 2
        H = pin.crba(model, data, q)
        H = np.triu(H) + np.triu(H, 1).T
        base = -np.linalg.solve(H[:6, :6], H[:6, 6:] @ qd)
        q = pin.integrate(model, q, h * np.concatenate((base, np.zeros(3))))
    q[7:] = q_all[-1]
    pin.framesForwardKinematics(model, data, q)
    tool = data.oMf[model.getFrameId("grip")]
    R, p = verification.tool_path(truth)
    np.testing.assert_allclose(p[0, -1], tool.translation, atol=1e-6)
    np.testing.assert_allclose(R[0, -1], tool.rotation, atol=1e-6)


def test_draws_are_the_single_results_stacked(verification, truth):
    rng = np.random.default_rng(1)
    draws = truth * (1 + 0.01 * rng.standard_normal((4, 20)))
    together = verification.error(draws, truth)
    for k, draw in enumerate(draws):
        alone = verification.error(draw, truth)
        np.testing.assert_allclose(together.position_m[k], alone.position_m[0], atol=1e-14)
        np.testing.assert_allclose(together.angle_rad[k], alone.angle_rad[0], atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-5, 0.3, 3.0])
def test_exponential_and_angle_agree_with_pinocchio(angle):
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    twist = np.concatenate((np.array([0.1, 0.2, -0.3]), angle * axis))
    R, p = exponential(twist)
    pose = pin.exp6(pin.Motion(twist))
    np.testing.assert_allclose(R, pose.rotation, atol=1e-14)
    np.testing.assert_allclose(p, pose.translation, atol=1e-14)
    assert rotation_angle(R) == pytest.approx(angle, abs=1e-14, rel=1e-12)
