"""The study's bounds: against the bench's other bound, and against each other."""

import numpy as np
import pytest

from hil.evidence.methods.cases import scenario_of, truth_of
from hil.evidence.methods.exact import base_velocity, exact_samples
from hil.evidence.methods.fisher import bound, information, sweep
from hil.judge.bound import Sensors, sensitivity
from hil.judge.floating import FloatingRobot
from hil.world.inertia import pi_of

CASE = "target"


@pytest.fixture(scope="module")
def robot():
    scenario = scenario_of(CASE)
    pis = {body: pi_of(report) for body, report in scenario.truth.items()}
    return FloatingRobot(scenario.urdf, scenario.tool_frame, pis, scenario.unknown)


def test_sensitivities_are_those_of_the_run_bound(robot):
    sensors = Sensors(
        joint_rate_hz=100.0,
        torque_noise_nm=np.ones(robot.n),
        torque_offset_sigma_nm=np.zeros(robot.n),
        imu_rate_hz=100.0,
        gyro_noise_rad_s=1.0,
        gyro_bias_sigma_rad_s=0.0,
        acc_noise_m_s2=1.0,
        acc_bias_sigma_m_s2=0.0,
        p_BS_m=np.zeros(3),
        R_BS=np.eye(3),
    )
    s, state = sweep(CASE), exact_samples(CASE)
    for i in (700, 3001):
        one = sensitivity(robot, sensors, truth_of(CASE), state.q[i], state.qd[i], state.qdd[i])
        np.testing.assert_allclose(s.J_tau[i], one.J_tau, rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(s.J_w[i], one.J_gyro, rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(s.J_a[i, :3], one.J_acc, rtol=1e-8, atol=1e-12)


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


def test_more_channels_never_know_less():
    all_channels = information(CASE, "data sheet", "all")
    for part in ("fused", "mrnea", "rda", "torque", "cm", "cm with v_b"):
        if part == "cm with v_b":
            continue  # base velocity is in no other choice
        own = np.sqrt(np.diag(bound(information(CASE, "data sheet", part))))
        # rounding only: MRNEA and RDA hold less than torque, accelerometer and gyro together
        assert np.all(own >= (1 - 1e-6) * np.sqrt(np.diag(bound(all_channels)))), part


def test_poor_imu_leaves_torque_s_information_alone():
    torque = np.diag(bound(information(CASE, "data sheet", "torque")))
    np.testing.assert_allclose(np.diag(bound(information(CASE, "poor IMU", "torque"))), torque)


def test_unknown_channels_are_refused():
    with pytest.raises(ValueError, match="gravity"):
        information(CASE, "data sheet", "gravity")
