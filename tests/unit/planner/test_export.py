"""Exports: CSV and a ROS-shaped JointTrajectory."""

import numpy as np
import yaml

from planner import export
from tests.support.excitation_cases import SHORT, motion

NAMES = tuple(f"joint{k + 1}" for k in range(7))


def test_csv_holds_time_and_four_derivatives(tmp_path):
    own, path = SHORT.trajectory(motion()), tmp_path / "t.csv"
    export.write_csv(own, dict.fromkeys(NAMES, "rad") | {NAMES[3]: "m"}, path, 10.0)
    header = path.read_text().splitlines()[0].split(",")
    assert header[:2] == ["t_s", "joint1_position_rad"]
    assert header[-1] == "joint7_jerk_rad_s3"
    assert header[4] == "joint4_position_m"
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    assert table.shape == (121, 29)
    np.testing.assert_allclose(table[:, 1:8], own.evaluate(table[:, 0])[0], atol=1e-9)


def test_joint_trajectory_has_the_message_s_fields(tmp_path):
    own, path = SHORT.trajectory(motion()), tmp_path / "t.yaml"
    export.write_joint_trajectory(own, NAMES, path, 2.0)
    message = yaml.safe_load(path.read_text())
    assert set(message) == {"header", "joint_names", "points"}
    assert message["joint_names"] == list(NAMES)
    times = [
        p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"]
        for p in message["points"]
    ]
    assert times == sorted(set(times))
    assert times[-1] == 12.0
    last = message["points"][-1]
    assert set(last) == {"positions", "velocities", "accelerations", "effort", "time_from_start"}
    np.testing.assert_allclose(last["velocities"], 0.0, atol=1e-9)
