"""Export of trajectories: CSV samples, and YAML in the shape of a ROS JointTrajectory message."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import yaml

from planner.spline import Trajectory


def sample_times(trajectory: Trajectory, rate_hz: float) -> np.ndarray:
    """Return equally spaced times from start to end [s], both included, at `rate_hz` or more."""
    count = int(np.ceil(trajectory.duration_s * rate_hz)) + 1
    return np.linspace(0.0, trajectory.duration_s, count)


def write_csv(
    trajectory: Trajectory, joints: Mapping[str, str], path: Path, rate_hz: float
) -> None:
    """Write time, positions, velocities, accelerations and jerks, one row per sample.

    `joints` : unit (rad or m) by joint name, in the model's order
    """
    t_s = sample_times(trajectory, rate_hz)
    header = ["t_s"]
    kinds = {"position": "", "velocity": "_s", "acceleration": "_s2", "jerk": "_s3"}
    for kind, per in kinds.items():
        header += [f"{name}_{kind}_{unit}{per}" for name, unit in joints.items()]
    table = np.column_stack([t_s, *trajectory.evaluate(t_s)])
    np.savetxt(path, table, delimiter=",", header=",".join(header), comments="", fmt="%.12g")


def write_joint_trajectory(
    trajectory: Trajectory, joint_names: tuple[str, ...], path: Path, rate_hz: float
) -> None:
    """Write a trajectory_msgs/JointTrajectory as YAML (effort left empty)."""
    t_s = sample_times(trajectory, rate_hz)
    q, qd, qdd, _ = trajectory.evaluate(t_s)
    points = []
    for k, t in enumerate(t_s):
        whole_ns = round(float(t) * 1e9)
        points.append(
            {
                "positions": [float(f"{x:.12g}") for x in q[k]],
                "velocities": [float(f"{x:.12g}") for x in qd[k]],
                "accelerations": [float(f"{x:.12g}") for x in qdd[k]],
                "effort": [],
                "time_from_start": {"sec": whole_ns // 10**9, "nanosec": whole_ns % 10**9},
            }
        )
    document = {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
        "joint_names": list(joint_names),
        "points": points,
    }
    text = yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=100)
    path.write_text(text, encoding="utf-8")
