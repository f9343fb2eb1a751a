"""What an unknown motion costs, where closed forms and dense algebra know it."""

import numpy as np
import pytest

from hil.judge.bound import Sensors, Summed
from hil.judge.unknown_motion import Encoders, UnknownMotion

RATE_HZ = 50.0
LENGTH_S = 60.0
ENCODER_HZ = 500.0


def encoders(noise_rad: float, n: int = 1) -> Encoders:
    return Encoders(
        rate_hz=ENCODER_HZ,
        angle_noise_rad=np.full(n, noise_rad),
        speed_noise_rad_s=np.full(n, np.inf),
        start_sigma_rad=np.full(n, np.inf),
    )


def of_speed(noise_rad_s: float) -> Encoders:
    return Encoders(
        rate_hz=ENCODER_HZ,
        angle_noise_rad=np.array([np.inf]),
        speed_noise_rad_s=np.array([noise_rad_s]),
        start_sigma_rad=np.array([1e-3]),
    )


@pytest.mark.parametrize(
    ("made", "noise", "power"),
    [(encoders, 1e-6, 4), (encoders, 1e-4, 4), (encoders, 1e-3, 4), (of_speed, 0.02, 2)],
)
def test_inertia_from_a_sinusoid_of_one_joint_is_known_as_its_spectrum_says(made, noise, power):
    """tau = I qdd: at one frequency, torque and I times the encoder's qdd have white densities."""
    inertia, torque_nm, w, swing = 2.0, 0.05, 2 * np.pi * 0.4, 0.3
    t = np.arange(0.0, LENGTH_S, 1 / RATE_HZ)
    unknown = UnknownMotion(made(noise), len(t), RATE_HZ, 1)
    known, weight = 0.0, ENCODER_HZ / RATE_HZ / torque_nm**2
    for k, acceleration in enumerate(-swing * w**2 * np.sin(w * t)):
        A, by_motion = np.array([[acceleration]]), np.array([[0.0, 0.0, inertia]])
        unknown.add(k, A, by_motion, np.array([weight]))
        known += weight * acceleration**2
    density = (torque_nm**2 + inertia**2 * w**power * noise**2) / ENCODER_HZ
    closed = 0.5 * LENGTH_S * (swing * w**2) ** 2 / density
    assert known - unknown.cost()[0, 0] == pytest.approx(closed, rel=0.01)


@pytest.fixture
def sensors() -> Sensors:
    return Sensors(
        joint_rate_hz=ENCODER_HZ,
        torque_noise_nm=np.full(3, 0.05),
        torque_offset_sigma_nm=np.full(3, 0.1),
        imu_rate_hz=ENCODER_HZ,
        gyro_noise_rad_s=1e-3,
        gyro_bias_sigma_rad_s=1e-3,
        acc_noise_m_s2=1e-2,
        acc_bias_sigma_m_s2=1e-2,
        p_BS_m=np.array([0.2, -0.1, 0.3]),
        R_BS=np.eye(3),
        torque_scale_sigma=0.01,
        momentum_sigma_nms=0.1,
    )


def sigmas(robot, sensors, x, swing, noise_rad):
    motion = swing(np.arange(0.0, 12.0, 0.1))
    summed = Summed(robot, sensors, x, motion, 10.0, None, encoders(noise_rad, 3))
    return [
        np.sqrt(np.diag(np.linalg.inv(summed.information(motion_known=known))))
        for known in (True, False)
    ]


def test_perfect_encoders_cost_nothing_and_coarser_ones_more(
    small_robot, small_bodies, swing, sensors
):
    robot, x = small_robot("target"), small_bodies["target"]
    known, shown = sigmas(robot, sensors, x, swing, 1e-9)
    np.testing.assert_allclose(shown, known, rtol=1e-5)
    coarse, coarser = (sigmas(robot, sensors, x, swing, noise)[1] for noise in (1e-4, 1e-3))
    assert np.all(coarse > known)
    assert np.all(coarser > coarse)


def test_nuisances_cost_what_their_priors_leave(small_robot, small_bodies, swing, sensors):
    from dataclasses import replace

    robot, x = small_robot("target"), small_bodies["target"]
    exact = replace(sensors, torque_scale_sigma=0.0, momentum_sigma_nms=0.0)
    without = sigmas(robot, exact, x, swing, 1e-5)[1]
    scales = sigmas(robot, replace(exact, torque_scale_sigma=0.01), x, swing, 1e-5)[1]
    momentum = sigmas(robot, replace(exact, momentum_sigma_nms=1.0), x, swing, 1e-5)[1]
    assert np.all(scales >= without * (1 - 1e-9))
    assert scales[0] > 1.01 * without[0]
    assert np.all(momentum >= without * (1 - 1e-9))
