"""The study's bounds: against the bench's other bound, and against each other."""

import numpy as np
import pytest

from evidence.methods.cases import scenario_of, truth_of
from evidence.methods.exact import base_velocity, exact_samples
from evidence.methods.fisher import bound, information, sweep
from hil.judge.floating import FloatingRobot
from hil.world.inertia import pi_of

CASE = "target"


@pytest.fixture(scope="module")
def robot():
    scenario = scenario_of(CASE)
    pis = {body: pi_of(report) for body, report in scenario.truth.items()}
    return FloatingRobot(scenario.urdf, scenario.tool_frame, pis, scenario.unknown)


def test_exact_samples_obey_the_bound_s_model(robot):
    # two engines: MuJoCo's motion against Pinocchio's regressor, momentum and base reaction
    state, pi = exact_samples(CASE), robot.stacked(truth_of(CASE))
    v = base_velocity(state)
    for i in (0, 1500, 4203):
        nu = np.concatenate((np.zeros(3), state.w_NB_B[i], state.qd[i]))
        a = np.concatenate((state.a_NB_B[i], state.wd_NB_B[i], state.qdd[i]))
        force = robot.regressor(state.q[i], nu, a) @ pi
        np.testing.assert_allclose(force[:6], 0.0, atol=1e-7)
        np.testing.assert_allclose(force[6:], state.tau[i], atol=1e-7)
        whole = np.concatenate((v[i], nu[3:]))
        momentum = robot.regressor(state.q[i], np.zeros(whole.size), whole)[:6] @ pi
        np.testing.assert_allclose(momentum, 0.0, atol=1e-6)


def test_sensitivities_to_joint_accelerations_are_finite_differences(robot):
    from evidence.methods.fisher import _sensors
    from hil.judge.bound import sensitivity

    s, state, x = sweep(CASE), exact_samples(CASE), truth_of(CASE)
    sensors = _sensors(CASE, robot.n)
    for i in (700, 3001):
        q, qd, qdd = state.q[i], state.qd[i], state.qdd[i]
        base = sensitivity(robot, sensors, x, q, qd, qdd)
        for j in range(robot.n):
            step = np.zeros(robot.n)
            step[j] = 1.0  # torque and force are affine in the accelerations
            moved = sensitivity(robot, sensors, x, q, qd, qdd + step)
            np.testing.assert_allclose(moved.tau_nm - base.tau_nm, s.D_tau[i][:, j], atol=1e-9)
            force = moved.f_NS_S_m_s2 - base.f_NS_S_m_s2
            np.testing.assert_allclose(force, s.D_acc[i][:, j], atol=1e-9)


def test_more_channels_never_know_less():
    all_channels = information(CASE, "data sheet", "all")
    for part in ("rda", "torque", "cm"):
        own = np.sqrt(np.diag(bound(information(CASE, "data sheet", part))))
        assert np.all(own >= (1 - 1e-6) * np.sqrt(np.diag(bound(all_channels)))), part


def test_poor_imu_leaves_torque_s_information_alone():
    torque = np.diag(bound(information(CASE, "data sheet", "torque")))
    np.testing.assert_allclose(np.diag(bound(information(CASE, "poor IMU", "torque"))), torque)


def test_unknown_channels_are_refused():
    with pytest.raises(ValueError, match="gravity"):
        information(CASE, "data sheet", "gravity")
