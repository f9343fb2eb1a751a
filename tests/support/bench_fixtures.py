"""A small robot of its own for the scoring tests: three joints, light base, offset tool."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hil.judge.floating import FloatingRobot
from hil.world.inertia import pi_of

BODIES = {
    "base": pi_of(np.array([150.0, 0.1, -0.05, -0.2, 20, 1, 0.5, 22, -0.7, 18])),
    "target": pi_of(np.array([60.0, 0.3, 0.1, 0.2, 8, 0.3, -0.2, 9, 0.4, 7])),
}
AXES = ("0 0 1", "0 1 0", "1 0 0")


def write_urdf(folder: Path) -> Path:
    links = '<link name="bus"/>'
    parent = "bus"
    for k, axis in enumerate(AXES):
        links += (
            f'<link name="l{k}"><inertial><origin xyz="0.02 0.01 0.25"/><mass value="{5 - k}"/>'
            '<inertia ixx="0.1" ixy="0.01" ixz="0" iyy="0.12" iyz="0" izz="0.05"/></inertial>'
            "</link>"
            f'<joint name="j{k}" type="revolute"><parent link="{parent}"/><child link="l{k}"/>'
            f'<origin xyz="0 0 0.5" rpy="0.1 0 0.2"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" effort="40" velocity="1"/></joint>'
        )
        parent = f"l{k}"
    links += (
        '<link name="grip"/><joint name="fix" type="fixed"><parent link="l2"/><child link="grip"/>'
        '<origin xyz="0.1 0 0.4" rpy="0.3 -0.2 0.1"/></joint>'
    )
    path = folder / "small.urdf"
    path.write_text(f'<robot name="small">{links}</robot>', encoding="utf-8")
    return path


@pytest.fixture
def small_robot(tmp_path: Path) -> Callable[..., FloatingRobot]:
    """Return the robot with the given unknown bodies."""
    urdf = write_urdf(tmp_path)
    return lambda *unknown: FloatingRobot(urdf, "grip", BODIES, unknown)


@pytest.fixture
def small_bodies() -> dict[str, np.ndarray]:
    """Parameters pi of the small robot's base and target."""
    return BODIES


@pytest.fixture
def swing() -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Smooth joint motion (rad, rad/s, rad/s2) of times [s], starting at rest."""
    return _swing


def _swing(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    t = np.asarray(t, float)[:, None]
    amplitude, rate = np.array([0.5, 0.4, 0.6]), np.array([0.7, 0.9, 1.1])
    return (
        amplitude * (1 - np.cos(rate * t)),
        amplitude * rate * np.sin(rate * t),
        amplitude * rate**2 * np.cos(rate * t),
    )
