"""Samples that another program decoded are calibrated and timed like those of the wire."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fsw.config import load
from fsw.drivers.sources.samples import (
    attitude_samples,
    imu_samples,
    joint_samples,
)
from fsw.drivers.sources.wheels import wheel_samples
from fsw.drivers.wire import ByteChunk
from tests.support.import_cases import robot
from tests.support.wheel_cases import wheel_config


@pytest.fixture
def rail(tmp_path: Path) -> Path:
    return robot(tmp_path, sampled=True, kinds=("revolute", "prismatic"))


def message(t_ns: int, **values: object) -> ByteChunk:
    return ByteChunk(t_ns, json.dumps(values).encode())


def test_sign_zero_gain_offset_and_latch_are_the_configurations(arm):
    first, second, third = arm.data["joints"]
    first |= {"sign": -1, "zero_offset_rad": 0.5}
    second |= {"torque_gain": 2.0, "torque_offset_nm": 3.0}
    third |= {"torque_limit_nm": 4.0}
    arm.data["buses"][0]["latch_offset_s"] = 1e-3
    source = joint_samples(load(arm.write()))
    angles = {"axis3": 0.3, "axis1": 0.1, "axis2": 0.2}
    samples = source.feed(
        [
            message(10, position_rad=angles, torque_nm={"axis1": 1.0, "axis2": 2.0, "axis3": 3.0}),
            message(20, position_rad=angles, torque_nm={"axis1": 1.0, "axis3": 5.0}),
        ]
    )
    assert samples.joint.tolist() == [0, 1, 2, 0, 1]
    assert np.allclose(samples.position_rad, [-0.6, 0.2, 0.3, -0.6, 0.2])
    assert np.allclose(samples.torque_nm, [-1.0, 1.0, 3.0, -1.0, np.nan], equal_nan=True)
    assert (samples.t_ns - samples.t_receive_ns == 1_000_000).all()
    assert (source.counters["accepted"], source.counters["reject_range"]) == (5, 1)


def test_a_prismatic_joint_has_metres_and_newtons_under_their_own_keys(rail):
    source = joint_samples(load(rail))
    samples = source.feed(
        [
            message(10, position_rad={"j1": 0.3}, torque_nm={"j1": 2.0}, position_m={"j2": 0.25}),
            message(20, position_rad={"j1": 0.3}, position_m={"j2": 0.5}, force_n={"j2": 7.0}),
            message(30, position_rad={"j1": 0.3, "j2": 0.5}),  # metres are no radians
        ]
    )
    assert samples.position_rad.tolist() == [0.3, 0.25, 0.3, 0.5]
    assert np.allclose(samples.torque_nm, [2.0, np.nan, np.nan, 7.0], equal_nan=True)
    assert source.counters["reject_length"] == 1


def test_a_joint_without_torque_sensor_has_none(arm):
    arm.data["joints"][0] = {
        key: value for key, value in arm.data["joints"][0].items() if "torque" not in key
    } | {"torque": "none"}
    angles = dict.fromkeys(("axis1", "axis2", "axis3"), 0.1)
    torques = dict.fromkeys(angles, 1.0)
    source = joint_samples(load(arm.write()))
    samples = source.feed([message(10, position_rad=angles, torque_nm=torques)])
    assert np.isnan(samples.torque_nm).tolist() == [True, False, False]


def test_clusters_have_their_delays_and_biases_and_may_be_missing(arm):
    arm.data["imu"] |= {"gyro_bias_S_rad_s": [0.1, 0, 0], "acc_bias_S_m_s2": [0, 0, 0.2]}
    config = load(arm.write()).imu
    rate, force = [0.3, 0.0, 0.0], [0.0, 0.0, 9.8]
    samples = imu_samples(config).feed(
        [
            message(10**9, w_NS_S_rad_s=rate, f_NS_S_m_s2=force),
            message(2 * 10**9, w_NS_S_rad_s=rate),
        ]
    )
    assert np.allclose(samples.w_NS_S_rad_s, [0.2, 0.0, 0.0])
    assert np.allclose(samples.f_NS_S_m_s2, [[0, 0, 9.6], [np.nan] * 3], equal_nan=True)
    assert samples.t_gyro_ns.tolist() == [997_800_000, 1_997_800_000]
    assert samples.t_acc_ns.tolist() == [993_700_000, 1_993_700_000]


def test_the_gyros_matrix_is_applied_after_its_bias(arm):
    matrix = [[1.01, 0.02, 0.0], [0.0, 1.0, 0.0], [-0.03, 0.0, 0.98]]
    arm.data["imu"] |= {"gyro_bias_S_rad_s": [0.1, 0, 0], "gyro_matrix": matrix}
    config = load(arm.write()).imu
    rate, force = [0.3, 0.4, -0.5], [0.0, 0.0, 9.8]
    samples = imu_samples(config).feed([message(10**9, w_NS_S_rad_s=rate, f_NS_S_m_s2=force)])
    assert np.allclose(samples.w_NS_S_rad_s, [[0.202 + 0.008, 0.4, -0.006 - 0.49]])
    assert np.allclose(samples.f_NS_S_m_s2, [force])


def test_quaternions_are_turned_to_the_base_and_must_be_rotations(arm):
    q_BS = Rotation.from_euler("xyz", [0.3, -0.2, 0.9])
    arm.data["star_tracker"]["mounting"]["q_BS_xyzw"] = q_BS.as_quat().tolist()
    tracker = load(arm.write()).star_tracker
    assert tracker is not None
    q_SN = Rotation.from_euler("xyz", [1.0, 0.4, -0.3])
    source = attitude_samples(tracker)
    samples = source.feed(
        [
            message(10**9, q_xyzw=q_SN.as_quat().tolist()),
            message(2 * 10**9, q_xyzw=[0, 0, 0, 0]),
            message(3 * 10**9, q_xyzw=[0, 0, 1]),
        ]
    )
    R_NB = Rotation.from_quat(samples.q_NB_xyzw[0]).as_matrix()
    assert np.allclose(R_NB, q_SN.as_matrix().T @ q_BS.as_matrix().T)
    assert samples.t_ns.tolist() == [900_000_000]
    assert source.counters["rejected"] == 2


def test_speeds_of_wheels_are_in_range_and_earlier_by_their_delay():
    slow = wheel_config(0, bus=None, node_id=None, delay_s=2e-3, speed_limit_rad_s=100.0)
    fast = wheel_config(1, bus=None, node_id=None)
    source = wheel_samples((slow, fast))
    samples = source.feed(
        [
            message(10_000_000, speed_rad_s={"wheel1": 99.0, "wheel2": 300.0}),
            message(20_000_000, speed_rad_s={"wheel1": 101.0, "wheel2": -300.0}),
            message(30_000_000, speed_rad_s={"wheel2": 1.0}),
        ]
    )
    assert samples.device.tolist() == [0, 1, 1, 1]
    assert samples.values[:, 0].tolist() == [99.0, 300.0, -300.0, 1.0]
    assert samples.t_ns.tolist() == [8_000_000, 10_000_000, 20_000_000, 30_000_000]
    assert np.isnan(samples.values[:, 1]).all()
