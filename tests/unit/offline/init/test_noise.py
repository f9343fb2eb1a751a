"""`fsw init --recording`: noise of logs that round, that have gaps, and of joints at rest."""

from pathlib import Path

import numpy as np
import pytest

from fsw.__main__ import main
from fsw.config import load
from offline.init.noise import sizes_of
from tests.conftest import arm_urdf

FLAGS = "--tool gripper --unknown target --target-mass-kg 2 --base clamped --imu none"
MOUNT = "--imu stim300 --imu-xyz 0 0 0 --imu-rpy 0 0 0 --tracker none"
RATE_HZ, ROWS = 100.0, 3000


def configured(folder: Path, t, q, tau, *more: str):
    (folder / "arm.urdf").write_text(arm_urdf(3))
    names = [f"{kind}_axis{k + 1}" for kind in ("pos", "effort") for k in range(3)]
    table = np.column_stack([t, q, tau])
    header = ",".join(["time", *names])
    np.savetxt(folder / "arm.csv", table, "%.9g", ",", header=header, comments="")
    out = folder / "robot.yaml"
    flags = [*FLAGS.split(), "--tracker", "none", "--recording", str(folder / "arm.csv"), *more]
    assert main(["init", str(folder / "arm.urdf"), "--out", str(out), *flags]) == 0
    assert main(["check", str(out)]) == 0
    return load(out), out.read_text()


def motion(rng):
    t = np.arange(ROWS) / RATE_HZ
    q = 0.6 * np.sin(t[:, None] * np.array([2.0, 3.0, 4.0]))
    return t, q, 20.0 * np.cos(q) + 0.2 * rng.normal(size=q.shape)


def test_rounded_angles_have_the_noise_of_their_rounding(tmp_path):
    """Angles printed to 1e-4 rad: 1e-4 / sqrt(12) = 2.9e-5 rad, of a moving joint."""
    t, q, tau = motion(np.random.default_rng(1))
    config, _ = configured(tmp_path, t, np.round(q, 4), tau)
    for joint in config.joints:
        assert 2.5e-5 < joint.position_noise_rad < 4.5e-5


def test_a_slow_joint_beside_a_fast_one_has_its_speed():
    """Its encoder counts in 1e-3 rad, so that it changes in one row of five."""
    t, q, tau = motion(np.random.default_rng(1))
    q[:, 2] = np.round(0.02 * t, 3)
    limits = sizes_of(t, q, tau, ["revolute"] * 3)
    assert limits[0].speed_rad_s == pytest.approx(1.2, rel=0.01)
    assert limits[2].speed_rad_s == pytest.approx(0.02, rel=0.2)
    q[:, 2] = 0.3
    q[50:52, 2] = 2.0
    assert sizes_of(t, q, tau, ["revolute"] * 3)[2].speed_rad_s == 0.0


def test_gaps_of_a_log_are_no_noise(tmp_path):
    """Three rows in ten are missing: differences of rows as they come would show the motion."""
    rng = np.random.default_rng(2)
    t, q, tau = motion(rng)
    keep = rng.random(ROWS) > 0.3
    config, _ = configured(
        tmp_path, t[keep], (q + 2e-5 * rng.normal(size=q.shape))[keep], tau[keep]
    )
    for joint in config.joints:
        assert joint.position_noise_rad == pytest.approx(2e-5, rel=0.3)


def test_a_joint_at_rest_has_the_noise_of_the_others(tmp_path):
    rng = np.random.default_rng(3)
    t, q, tau = motion(rng)
    q += 3e-5 * rng.normal(size=q.shape)
    q[:, 1] = 0.25
    config, _ = configured(tmp_path, t, q, tau)
    assert config.joints[1].position_noise_rad == pytest.approx(3e-5, rel=0.3)


def test_a_joint_at_rest_whose_encoder_is_noisier_keeps_its_noise():
    rng = np.random.default_rng(8)
    t, q, tau = motion(rng)
    q += 1e-6 * rng.normal(size=q.shape)
    q[:, 2] = 0.25 + 1e-4 * rng.normal(size=ROWS)
    limits = sizes_of(t, q, tau, ["revolute"] * 3)
    assert limits[0].position_noise_rad == pytest.approx(1e-6, rel=0.2)
    assert limits[2].position_noise_rad == pytest.approx(1e-4, rel=0.2)


def test_check_finds_the_noise_that_init_wrote_in_the_same_recording(tmp_path, capsys):
    """Rows repeat, as of a joint state that is logged twice; one joint is held and quieter."""
    rng = np.random.default_rng(7)
    t, q, tau = motion(rng)
    q += 3e-5 * rng.normal(size=q.shape)
    q[:, 2] = 0.25 + 1e-7 * rng.normal(size=ROWS)
    q[1::2] = q[::2]
    configured(tmp_path, t, q, tau)
    robot, recording = str(tmp_path / "robot.yaml"), str(tmp_path / "arm.mcap")
    mapping = ["--map", str(tmp_path / "robot.map.yaml"), "--config", robot, "--out", recording]
    assert main(["import", str(tmp_path / "arm.csv"), *mapping]) == 0
    capsys.readouterr()
    main(["check", robot, recording])
    said = [line for line in capsys.readouterr().out.splitlines() if "position_noise" in line]
    assert len(said) == 3
    assert not [line for line in said if "WRONG" in line], said


def test_filtered_torques_are_not_taken_for_noiseless(tmp_path):
    """A controller's smoothed torque has no noise to see; the device's share remains: 0.015 N m."""
    t, q, _ = motion(np.random.default_rng(4))
    config, _ = configured(tmp_path, t, q + 1e-12 * t[:, None], 20.0 * np.cos(q))
    assert all(joint.torque_noise_nm >= 3e-4 * 50.0 for joint in config.joints)


def test_a_held_arm_has_friction_doubtful_links_and_an_imperfect_model(tmp_path):
    config, text = configured(tmp_path, *motion(np.random.default_rng(5)))
    assert config.robot.links_sigma_ratio == 0.2
    for joint in config.joints:
        assert joint.torque == "link_side"
        assert joint.friction_coulomb_sigma_nm > 0.0 < joint.friction_viscous_sigma_nms_rad
        assert joint.torque_model_sigma_nm > 0.0
    assert "guess" in text


def test_the_flag_for_motor_current_leaves_the_wide_priors_to_that_key(tmp_path):
    config, text = configured(
        tmp_path, *motion(np.random.default_rng(6)), "--torque", "motor_current"
    )
    assert "friction_coulomb" not in text
    for joint in config.joints:
        assert joint.torque == "motor_current"
        assert joint.friction_coulomb_sigma_nm == pytest.approx(5.0)
        assert joint.friction_load_sigma_ratio == pytest.approx(0.1)
        assert joint.torque_scale_sigma_ratio == pytest.approx(0.2)
        assert joint.torque_noise_nm == pytest.approx(0.2)  # of the limit: columns may be amperes


def test_a_free_base_is_as_before(tmp_path):
    (tmp_path / "arm.urdf").write_text(arm_urdf(3))
    flags = FLAGS.replace("--base clamped --imu none", MOUNT).split()
    out = tmp_path / "robot.yaml"
    assert main(["init", str(tmp_path / "arm.urdf"), "--out", str(out), *flags]) == 0
    config = load(out)
    assert config.robot.links_sigma_ratio == 0.05
    assert all(joint.friction_coulomb_sigma_nm == 0.0 for joint in config.joints)
