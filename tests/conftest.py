"""Fixtures every test of the project may use: a small robot and its configuration."""

import gc
import os
import subprocess
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
import yaml
from hypothesis import settings

from hil.run.processes import end_with, tied

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: ten times as fast on small ones

pytest_plugins = ["tests.support.bench_fixtures", "tests.support.telemetry_fixtures"]

settings.register_profile("project", deadline=None, derandomize=True, max_examples=200)
settings.load_profile("project")

HERE = Path(__file__).parent
AXES = ("0 0 1", "0 1 0")


class TiedPopen(subprocess.Popen):
    """A process that ends with this one: also when pytest is killed, nothing is left behind."""

    def __init__(self, args: Any, *rest: Any, env: Mapping[str, str] | None = None, **more: Any):
        alone = isinstance(args, str) or more.get("shell") or more.get("executable")
        super().__init__(args if alone else tied(args, env), *rest, env=env, **more)


def pytest_configure(config: pytest.Config) -> None:
    """Tie every process a test starts to this one, and a worker of xdist to its controller.

    One simulation of a truth serves all tests of this run (`hil/world/simulation.py`).
    """
    gc.disable()  # until all tests are collected: nothing of them is garbage
    if hasattr(config, "workerinput"):
        end_with(os.getppid())
    elif "HIL_TRUTH_CACHE" not in os.environ:
        folder = TemporaryDirectory(prefix="truth-")
        config.add_cleanup(folder.cleanup)
        os.environ["HIL_TRUTH_CACHE"] = folder.name
    subprocess.Popen = TiedPopen


def arm_urdf(joints: int, *, joint_type: str = "revolute") -> str:
    """Return the URDF of a slender arm of alternating axes on a box; fixed frame `gripper`."""
    parts = [
        '<robot name="arm"><link name="bus"><inertial><origin xyz="0.1 0 -0.3"/>'
        '<mass value="200"/>'
        '<inertia ixx="60" ixy="0" ixz="0" iyy="50" iyz="0" izz="40"/></inertial></link>'
    ]
    parent = "bus"
    for k in range(1, joints + 1):
        parts.append(
            f'<joint name="axis{k}" type="{joint_type}"><parent link="{parent}"/>'
            f'<child link="link{k}"/><origin xyz="0 0 0.4"/><axis xyz="{AXES[(k + 1) % 2]}"/>'
            '<limit lower="-3" upper="3" effort="50" velocity="0.5"/></joint>'
            f'<link name="link{k}"><inertial><origin xyz="0 0 0.2"/><mass value="3"/>'
            '<inertia ixx="0.04" ixy="0" ixz="0" iyy="0.04" iyz="0" izz="0.01"/></inertial></link>'
        )
        parent = f"link{k}"
    parts.append(
        f'<joint name="mount" type="fixed"><parent link="{parent}"/><child link="gripper"/>'
        '<origin xyz="0 0 0.3"/></joint><link name="gripper"/></robot>'
    )
    return "".join(parts)


def arm_config(joints: int) -> dict[str, Any]:
    """Return the plain data of a correct configuration for `arm_urdf(joints)`."""
    return {
        "robot": {"urdf": "arm.urdf", "tool_frame": "gripper"},
        "unknown": ["target"],
        "bodies": {
            "target": {
                "mass_kg": 80.0,
                "com_m": [0.1, 0.0, 0.4],
                "inertia_kg_m2": [6.0, 0.0, 0.0, 5.0, 0.0, 4.0],
                "sigma": {
                    "mass_kg": 40.0,
                    "com_m": [0.2, 0.2, 0.2],
                    "inertia_kg_m2": [3.0, 1.0, 1.0, 3.0, 1.0, 3.0],
                },
            }
        },
        "buses": [
            {
                "name": "arm",
                "interface": "virtual",
                "channel": "arm",
                "bitrate": 1_000_000,
                "rate_hz": 250.0,
            }
        ],
        "joints": [
            {
                "name": f"axis{k}",
                "bus": "arm",
                "node_id": 0x10 + k,
                "torque_limit_nm": 50.0,
                "speed_limit_rad_s": 0.5,
                "torque_noise_nm": 0.05,
                "torque_offset_sigma_nm": 0.1,
                "position_noise_rad": 1e-5,
            }
            for k in range(1, joints + 1)
        ],
        "imu": {
            "port": "/dev/serial/imu",
            "rate_hz": 500.0,
            "mounting": {"p_BS_m": [0.2, 0.1, 0.0], "q_BS_xyzw": [0.0, 0.0, 0.0, 1.0]},
            "gyro_group_delay_s": 0.0022,
            "acc_group_delay_s": 0.0063,
            "angle_random_walk_rad_sqrt_s": 4.4e-5,
            "velocity_random_walk_m_s_sqrt_s": 1e-3,
            "gyro_bias_sigma_rad_s": 1e-5,
            "acc_bias_sigma_m_s2": 1e-2,
        },
        "star_tracker": {
            "port": "/dev/serial/star_tracker",
            "rate_hz": 5.0,
            "mounting": {"p_BS_m": [0.0, 0.3, 0.0], "q_BS_xyzw": [0.0, 0.0, 0.0, 1.0]},
            "latency_s": 0.1,
            "noise_across_rad": 1e-5,
            "noise_about_rad": 5e-5,
        },
        "scheduler": {"tick_rate_hz": 500.0, "realtime_priority": 0},
        "recorder": {"directory": "recordings"},
        "service": {"state_directory": "state"},
    }


class ArmProject:
    """A folder with a robot and a configuration to be spoiled and written."""

    def __init__(self, folder: Path, joints: int = 3) -> None:
        self.folder = folder
        self.data = arm_config(joints)
        self.urdf = ""
        self.robot(joints)

    def robot(self, joints: int, joint_type: str = "revolute") -> None:
        """Replace the robot by one of another number or type of joints."""
        self.urdf = arm_urdf(joints, joint_type=joint_type)

    def write(self) -> Path:
        """Write both files; return the configuration's path."""
        (self.folder / "arm.urdf").write_text(self.urdf)
        path = self.folder / "config.yaml"
        path.write_text(yaml.safe_dump(self.data))
        return path


@pytest.fixture
def arm(tmp_path: Path) -> ArmProject:
    return ArmProject(tmp_path)


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


def lane_of(item: pytest.Item) -> str:
    """Return the folder of `tests` that a test stands in, or its file's name."""
    return item.path.relative_to(HERE).parts[0]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every test with the lane of its folder; put the lane of the shortest files last.

    Workers take files in this order, so at the end each of them has little left to do.
    """
    last = ("virtual", "unit")
    items.sort(key=lambda item: last.index(lane) + 1 if (lane := lane_of(item)) in last else 0)
    for item in items:
        lane = lane_of(item)
        if lane in {"unit", "virtual", "live", "long"}:
            item.add_marker(lane)
