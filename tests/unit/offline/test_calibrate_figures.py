"""An overlay undoes the errors that its figures state, and says nothing of what was refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fsw.config import load
from fsw.config.overlay_file import with_overlays
from fsw.errors import EstimatorError
from offline.calibrate.figures import Figure, in_axes, overlay_text, overlay_values, table
from offline.calibrate.rest import rest_figures


def figure(name: str, value: float, sigma: float = 1e-3, known: float = 1.0) -> Figure:
    kind, _, which = name.partition(".")
    return Figure(kind=kind, which=which, value=value, sigma=sigma, known=known)


def laid(arm, *figures: Figure):
    config = load(arm.write())
    path = arm.folder / "calibration.yaml"
    path.write_text(overlay_text(overlay_values(config, figures), ["a comment", *table(figures)]))
    return config, with_overlays(config, [path])


@pytest.mark.parametrize(("before", "gain"), [(0.0, 1.0), (0.3, 1.2)])
def test_the_torque_is_the_dynamics_again(arm, before, gain):
    arm.data["joints"][1] |= {"torque_offset_nm": before, "torque_gain": gain}
    name, scale, offset = arm.data["joints"][1]["name"], 0.05, -0.2
    config, after = laid(
        arm, figure(f"torque_scale.{name}", scale), figure(f"torque_offset.{name}", offset)
    )
    dynamics = np.array([-3.0, 0.0, 7.0])
    reading = (dynamics * (1.0 + scale) + offset + before) / gain
    joint = after.joints[1]
    assert joint.torque_gain * reading - joint.torque_offset_nm == pytest.approx(dynamics)
    assert joint.torque_scale_sigma_ratio == joint.torque_offset_sigma_nm == 1e-3
    assert after.joints[0] == config.joints[0]


def test_biases_mounting_and_delays_are_added_to_what_is_configured(arm):
    angle, place = np.array([0.1, -0.2, 0.3]), np.array([0.01, 0.02, -0.03])
    sigmas = dict(zip("xyz", (1e-3, 3e-3, 2e-3), strict=True))
    figures = [
        *(figure(f"imu_angle.{a}", v) for a, v in zip("xyz", angle, strict=True)),
        *(figure(f"imu_place.{a}", v, sigmas[a]) for a, v in zip("xyz", place, strict=True)),
        *(figure(f"gyro_bias.{a}", 1e-4) for a in "xyz"),
        figure("acc_bias.y", 0.02),
        figure("delay.gyro", 0.001),
    ]
    config, after = laid(arm, *figures)
    before, now = config.imu.mounting, after.imu.mounting
    turned = Rotation.from_quat(now.q_BS_xyzw) * Rotation.from_quat(before.q_BS_xyzw).inv()
    assert turned.as_rotvec() == pytest.approx(angle)
    assert np.array(now.p_BS_m) - before.p_BS_m == pytest.approx(place)
    assert after.imu.mounting_position_sigma_m == 3e-3  # one key: the largest
    assert after.imu.gyro_bias_S_rad_s == (1e-4, 1e-4, 1e-4)
    assert after.imu.acc_bias_S_m_s2 == (0.0, 0.02, 0.0)
    assert after.imu.acc_bias_sigma_m_s2 == config.imu.acc_bias_sigma_m_s2  # x and z are as before
    assert after.imu.gyro_group_delay_s == pytest.approx(config.imu.gyro_group_delay_s + 0.001)


def test_scales_and_axes_of_the_gyro_are_joined_to_its_matrix(arm):
    """A reading K^-1 w + b with what is found added is w again."""
    before = np.array([[1.01, 0.0, 0.0], [0.02, 1.0, 0.0], [0.0, 0.0, 0.99]])
    arm.data["imu"] |= {"gyro_matrix": before.tolist()}
    scale, axes, bias = (0.004, -0.003, 0.002), (0.01, 0.005, -0.008), (1e-3, 2e-3, -1e-3)
    figures = [
        *(figure(f"gyro_scale.{a}", v) for a, v in zip("xyz", scale, strict=True)),
        *(figure(f"gyro_axes.{a}", v, 4e-3) for a, v in zip(("xy", "xz", "yz"), axes, strict=True)),
        *(figure(f"gyro_bias.{a}", v) for a, v in zip("xyz", bias, strict=True)),
    ]
    after = laid(arm, *figures)[1].imu
    xy, xz, yz = axes
    E = np.array([[scale[0], xy, xz], [xy, scale[1], yz], [xz, yz, scale[2]]])
    w, reading = np.array([0.3, -0.5, 0.7]), np.array([0.31, -0.48, 0.72])
    reading = np.linalg.solve(before, np.linalg.solve(np.eye(3) + E, w) + bias)
    assert np.array(after.gyro_matrix) @ (reading - after.gyro_bias_S_rad_s) == pytest.approx(w)
    assert (after.gyro_scale_sigma_ratio, after.gyro_axes_sigma_rad) == (1e-3, 4e-3)


def test_what_the_configuration_knows_better_is_left_out(arm):
    config = load(arm.write())
    weak = figure("torque_offset.joint1", 0.5, sigma=0.8, known=1.0)
    assert weak.verdict == "prior-dominated"
    assert not weak.measured
    assert overlay_values(config, [weak]) == {}
    assert "not used: +- 1 is configured" in table([weak])[0]


def test_a_vector_and_its_covariance_are_turned():
    R = Rotation.from_euler("z", 90.0, degrees=True).as_matrix()
    found = in_axes("acc_bias", np.array([1.0, 2.0, 3.0]), np.diag([1.0, 4.0, 9.0]), R, 10.0)
    assert [one.value for one in found] == pytest.approx([-2.0, 1.0, 3.0])
    assert [one.sigma for one in found] == pytest.approx([2.0, 1.0, 3.0])


def test_a_recording_without_windows_is_too_short(arm):
    with pytest.raises(EstimatorError, match="0 usable windows at rest; must be 8 or more"):
        rest_figures(load(arm.write()), None, [], [])
