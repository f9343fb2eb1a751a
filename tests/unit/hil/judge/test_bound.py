"""The bound's predictions against forward dynamics, its Jacobians against differences."""

import numpy as np
import pinocchio as pin
import pytest

from hil.judge.applied import NOTHING, Applied
from hil.judge.bound import Sensors, information, sensitivity
from hil.judge.floating import FloatingRobot
from tests.support.bench_fixtures import BODIES

SENSORS = Sensors(
    joint_rate_hz=500.0,
    torque_noise_nm=np.full(3, 0.05),
    torque_offset_sigma_nm=np.array([0.1, 0.0, 0.1]),
    imu_rate_hz=500.0,
    gyro_noise_rad_s=1e-3,
    gyro_bias_sigma_rad_s=1e-3,
    acc_noise_m_s2=1e-2,
    acc_bias_sigma_m_s2=1e-2,
    p_BS_m=np.array([0.2, -0.1, 0.3]),
    R_BS=pin.exp3(np.array([0.2, 0.5, -0.4])),
)


FIRING = Applied(
    wrench=np.array([20.0, -5.0, 8.0, 3.0, -12.0, 6.0]),
    momentum=np.array([4.0, 9.0, -6.0, 2.0, -3.0, 7.0]),
)
on_base = pytest.mark.parametrize("applied", [NOTHING, FIRING], ids=["alone", "fired"])


def readings(s):
    return np.concatenate((s.tau_nm, s.f_NS_S_m_s2, s.w_NS_S_rad_s))


@pytest.fixture
def truth(small_bodies):
    return np.concatenate([small_bodies["base"], small_bodies["target"]])


@pytest.fixture
def state(swing):
    return tuple(row[0] for row in swing(np.array([1.3])))


def stacked(s):
    return np.concatenate((s.tau_nm, s.w_NS_S_rad_s, s.f_NS_S_m_s2))


def test_a_continuous_joint_counts_as_a_revolute_one(small_robot, tmp_path, truth, state):
    fixed = sensitivity(small_robot("base", "target"), SENSORS, truth, *state)
    urdf = tmp_path / "small.urdf"
    urdf.write_text(urdf.read_text().replace('"j1" type="revolute"', '"j1" type="continuous"'))
    robot = FloatingRobot(urdf, "grip", BODIES, ("base", "target"))
    endless = sensitivity(robot, SENSORS, truth, *state)
    np.testing.assert_allclose(stacked(endless), stacked(fixed), atol=1e-12)
    np.testing.assert_allclose(endless.J_tau, fixed.J_tau, atol=1e-12)
    assert np.allclose(robot.tool_pose(state[0])[0], small_robot("base").tool_pose(state[0])[0])


@on_base
def test_jacobians_match_central_differences(small_robot, truth, state, applied):
    robot = small_robot("base", "target")
    s = sensitivity(robot, SENSORS, truth, *state, applied)
    columns = []
    for unit in np.eye(20):
        step = 1e-4
        up = stacked(sensitivity(robot, SENSORS, truth + step * unit, *state, applied))
        down = stacked(sensitivity(robot, SENSORS, truth - step * unit, *state, applied))
        columns.append((up - down) / (2 * step))
    J = np.concatenate((s.J_tau, s.J_gyro, s.J_acc))
    np.testing.assert_allclose(J, np.stack(columns, 1), atol=1e-8, rtol=1e-6)


@on_base
def test_derivatives_by_motion_match_central_differences(small_robot, truth, state, applied):
    robot = small_robot("base", "target")
    s = sensitivity(robot, SENSORS, truth, *state, applied)
    motion, columns, step = np.concatenate(state), [], 1e-5
    for unit in np.eye(9):
        up, down = (
            sensitivity(robot, SENSORS, truth, *np.split(motion + way * step * unit, 3), applied)
            for way in (1.0, -1.0)
        )
        columns.append((readings(up) - readings(down)) / (2 * step))
    np.testing.assert_allclose(s.by_motion, np.stack(columns, 1), atol=1e-7, rtol=1e-6)


def test_momentum_turns_the_whole_as_a_rigid_body(small_robot, truth, state):
    """To first order a momentum adds the rate H^-1 L of the whole, its arm held."""
    robot = small_robot("base", "target")
    s = sensitivity(robot, SENSORS, truth, *state)
    H_bb = (robot.mass_columns(state[0]) @ robot.stacked(truth))[:6]
    rate = np.linalg.solve(H_bb, np.eye(6)[:, 3:])[3:]
    np.testing.assert_allclose(s.by_momentum[6:, 3:], SENSORS.R_BS.T @ rate, rtol=1e-9)


@on_base
def test_predictions_match_forward_dynamics_with_a_moving_base(small_robot, truth, state, applied):
    robot = small_robot("base", "target")
    s = sensitivity(robot, SENSORS, truth, *state, applied)
    pi = robot.stacked(truth)
    model = robot.model.copy()
    for joint in range(1, model.njoints):
        model.inertias[joint] = pin.Inertia.FromDynamicParameters(pi[10 * (joint - 1) : 10 * joint])
    data = model.createData()
    q = pin.neutral(model)
    q[7:] = state[0]
    H = pin.crba(model, data, q)
    H = np.triu(H) + np.triu(H, 1).T
    twist = np.linalg.solve(H[:6, :6], applied.momentum - H[:6, 6:] @ state[1])
    nu = np.concatenate((twist, state[1]))  # the true, non-zero base velocity
    force = np.concatenate((applied.wrench, s.tau_nm))
    a = pin.aba(model, data, q, nu, force)
    np.testing.assert_allclose(a[6:], state[2], atol=1e-9)
    r, R = SENSORS.p_BS_m, SENSORS.R_BS
    w, wd = twist[3:], a[3:6]
    classical = a[:3] + np.cross(w, twist[:3])
    specific = classical + np.cross(wd, r) + np.cross(w, np.cross(w, r))
    np.testing.assert_allclose(s.f_NS_S_m_s2, R.T @ specific, atol=1e-9)
    np.testing.assert_allclose(s.w_NS_S_rad_s, R.T @ w, atol=1e-12)


def test_information_equals_the_dense_sum_without_nuisances(small_robot, small_bodies, swing):
    robot = small_robot("target")
    x = small_bodies["target"]
    motion = swing(np.linspace(0.0, 3.0, 30))
    fast = information(robot, SENSORS, x, motion, rate_hz=100.0)
    rows, weights = [], []
    for state in zip(*motion, strict=True):
        s = sensitivity(robot, SENSORS, x, *state)
        biases = np.eye(9)[:, [0, 2, 3, 4, 5, 6, 7, 8]]  # joint 2's offset is known
        rows.append(np.hstack((np.concatenate((s.J_tau, s.J_acc, s.J_gyro)), biases)))
        noise = np.repeat([0.05, 1e-2, 1e-3], 3)
        weights.append(5.0 / noise**2)  # 500 Hz native, 100 Hz evaluated
    A, w = np.concatenate(rows), np.concatenate(weights)
    full = A.T @ (w[:, None] * A)
    full[10:, 10:] += np.diag(np.repeat([0.1, 1e-2, 1e-3], [2, 3, 3]) ** -2.0)
    bound = np.linalg.inv(full)[:10, :10]
    np.testing.assert_allclose(np.linalg.inv(fast), bound, rtol=1e-6)


def test_information_does_not_depend_on_the_sampling(small_robot, small_bodies, swing):
    robot = small_robot("target")
    bounds = []
    for rate in (25.0, 50.0):
        t = np.arange(0.0, 6.0, 1 / rate)
        info = information(robot, SENSORS, small_bodies["target"], swing(t), rate)
        bounds.append(np.sqrt(np.diag(np.linalg.inv(info))))
    assert bounds[0] == pytest.approx(bounds[1], rel=0.03)
