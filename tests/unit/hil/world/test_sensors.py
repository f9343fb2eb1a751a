import math

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from hil.world.sensor_config import SensorConfig
from hil.world.sensors import (
    ImuErrors,
    JointErrors,
    angular_rate,
    attitude,
    generator,
    rotation_of,
    specific_force,
)
from tests.support.plant_cases import AnalyticHistory, sensor_config

Q_BS = tuple(Rotation.from_euler("xyz", [0.3, -0.7, 1.1]).as_quat().tolist())


def assert_sigma(values: np.ndarray, sigma: float) -> None:
    """Two-sided chi-square bound at 1e-6 on the variance of independent zero-mean values."""
    k = values.size
    ratio = float(np.sum(values**2)) / sigma**2
    assert chi2.ppf(5e-7, k) < ratio < chi2.isf(5e-7, k)


def test_unknown_and_missing_keys_are_refused():
    with pytest.raises(ValidationError, match="torque_nois"):
        sensor_config(joints={"torque_nois": 1.0})
    with pytest.raises(ValidationError, match="torque_offset_sigma_nm"):
        SensorConfig.from_dict({"joints": {"torque_noise_nm": 0.1}})


def test_joint_noise_has_the_configured_sigma():
    config = sensor_config({"torque_noise_nm": 0.03, "encoder_noise_rad": 1e-3}).joints
    errors = JointErrors(config, 7, 5)
    rows = [errors.measure(*np.zeros((3, 7))) for _ in range(3000)]
    assert_sigma(np.array([torque for _, torque in rows]), 0.03)
    assert_sigma(np.array([position for position, _ in rows]), 1e-3)


def test_encoder_rounds_to_its_own_count():
    errors = JointErrors(sensor_config({"encoder_bits": 12}).joints, 3, 5)
    position, _ = errors.measure(np.array([0.1, -0.2, 3.0]), *np.zeros((2, 3)))
    counts = position / (2 * math.pi) * 4096
    assert np.abs(counts - np.rint(counts)).max() < 1e-9
    assert np.abs(position - [0.1, -0.2, 3.0]).max() <= math.pi / 4096 + 1e-12


def test_torque_offsets_and_scales_are_drawn_once_per_seed():
    config = sensor_config(
        {"torque_offset_sigma_nm": 0.2, "torque_scale_error_ratio": 0.005}
    ).joints
    offsets = [JointErrors(config, 7, seed).torque_offset_nm for seed in range(300)]
    scales = [JointErrors(config, 7, seed).torque_scale - 1.0 for seed in range(300)]
    assert_sigma(np.array(offsets), 0.2)
    assert_sigma(np.array(scales), 0.005)
    assert np.array_equal(offsets[4], JointErrors(config, 7, 4).torque_offset_nm)


def test_one_joints_noise_does_not_depend_on_how_many_there_are():
    config = sensor_config({"torque_noise_nm": 0.03, "torque_offset_sigma_nm": 0.1}).joints
    few, many = JointErrors(config, 2, 9), JointErrors(config, 7, 9)
    for _ in range(600):
        a = few.measure(*np.zeros((3, 2)))[1]
        assert np.array_equal(a, many.measure(*np.zeros((3, 7)))[1][:2])


def test_imu_noise_is_random_walk_density_times_root_rate():
    imu = {
        "angle_random_walk_rad_sqrt_s": 4.4e-5,
        "velocity_random_walk_m_s_sqrt_s": 1e-3,
        "rate_hz": 500,
    }
    errors = ImuErrors(sensor_config(imu=imu).imu, 3).next(20_000)
    assert_sigma(errors[:, :3], 4.4e-5 * math.sqrt(500))
    assert_sigma(errors[:, 3:], 1e-3 * math.sqrt(500))


def test_imu_biases_are_drawn_from_their_sigma_and_wander_only_when_asked():
    imu = {"gyro_bias_sigma_rad_s": 2e-5, "acc_bias_sigma_m_s2": 5e-3}
    config = sensor_config(imu=imu).imu
    drawn = [ImuErrors(config, seed) for seed in range(300)]
    assert_sigma(np.array([d.gyro_bias_rad_s for d in drawn]), 2e-5)
    assert_sigma(np.array([d.acc_bias_m_s2 for d in drawn]), 5e-3)
    errors = drawn[0].next(100)
    assert np.ptp(errors, axis=0).max() == 0.0
    walking = ImuErrors(sensor_config(imu=imu | {"gyro_bias_walk_rad_s_sqrt_s": 1e-4}).imu, 1)
    steps = np.diff(np.vstack([walking.next(1000), walking.next(1000)])[:, :3], axis=0)
    assert_sigma(steps, 1e-4 / math.sqrt(500))


def test_specific_force_is_the_second_derivative_of_the_sensors_place():
    # Base turning about a fixed axis with constant acceleration while its origin oscillates.
    axis = np.array([0.6, 0.0, 0.8])
    r, R_BS = np.array([0.3, -0.2, 0.5]), rotation_of(Q_BS)

    def attitude_of(t: float) -> np.ndarray:
        return Rotation.from_rotvec(axis * (0.4 * t + 0.35 * t * t)).as_matrix()

    def place(t: float) -> np.ndarray:
        return np.array([math.sin(t), 0.5 * math.cos(2 * t), t**3]) + attitude_of(t) @ r

    t, h = 0.8, 1e-3
    second = (place(t + h) - 2 * place(t) + place(t - h)) / h**2
    origin = np.array([-math.sin(t), -2.0 * math.cos(2 * t), 6 * t])
    state = AnalyticHistory().at(np.array([t]))
    state.w_NB_B = (axis * (0.4 + 0.7 * t))[None]
    state.wd_NB_B = (axis * 0.7)[None]
    state.a_NB_B = (attitude_of(t).T @ origin)[None]
    expected = R_BS.T @ attitude_of(t).T @ second
    # Central difference: error h^2/12 times a fourth derivative below 10.
    assert np.abs(specific_force(state, tuple(r), R_BS)[0] - expected).max() < 1e-5
    assert np.allclose(angular_rate(state, R_BS)[0], R_BS.T @ state.w_NB_B[0])


def test_attitude_noise_is_about_the_trackers_own_axes():
    tracker = {"noise_across_rad": 1e-5, "noise_about_rad": 5e-5, "q_BS_xyzw": list(Q_BS)}
    config = sensor_config(star_tracker=tracker).star_tracker
    R_NB = Rotation.from_euler("xyz", [0.2, 0.5, -0.4])
    true = (Rotation.from_quat(Q_BS).inv() * R_NB.inv()).as_matrix()
    rng = generator(3, "star_tracker")
    errors = []
    for _ in range(3000):
        w, x, y, z = attitude(R_NB.as_matrix(), config, rng.standard_normal(3))
        errors.append(Rotation.from_quat([x, y, z, w]) * Rotation.from_matrix(true).inv())
    vectors = np.array([e.as_rotvec() for e in errors])
    assert_sigma(vectors[:, :2], 1e-5)
    assert_sigma(vectors[:, 2], 5e-5)


def test_rotation_sense_turns_the_quaternion_round():
    R_NB = Rotation.from_euler("xyz", [0.2, 0.5, -0.4]).as_matrix()
    there = sensor_config().star_tracker
    back = sensor_config(star_tracker={"rotation": "tracker_to_inertial"}).star_tracker
    w, x, y, z = attitude(R_NB, there, np.zeros(3))
    assert np.allclose(Rotation.from_quat([x, y, z, w]).as_matrix(), R_NB.T)
    assert np.allclose(attitude(R_NB, back, np.zeros(3)), (w, -x, -y, -z))


def test_friction_is_added_before_the_scale_and_drawn_once_per_seed():
    keys = {"friction_coulomb_sigma_nm": 0.3, "friction_viscous_sigma_nms_rad": 0.5}
    config = sensor_config({"torque_noise_nm": 0.0, **keys}).joints
    errors = JointErrors(config, 7, 5)
    friction = errors.friction
    fast = errors.measure(np.zeros(7), np.full(7, 0.2), np.ones(7))[1]
    np.testing.assert_allclose(fast, 1.0 + friction.coulomb_nm + 0.2 * friction.viscous_nms_rad)
    back = errors.measure(np.zeros(7), np.full(7, -0.2), np.ones(7))[1]
    np.testing.assert_allclose(fast + back, 2.0)
    assert np.array_equal(errors.measure(*np.zeros((3, 7)))[1], np.zeros(7))
    drawn = [JointErrors(config, 7, seed).friction.coulomb_nm for seed in range(300)]
    assert_sigma(np.array(drawn), 0.3)
