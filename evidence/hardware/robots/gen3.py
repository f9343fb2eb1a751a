"""A Kinova Gen3 with a Robotiq gripper: joint torque sensors and motor currents at 1 kHz."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from functools import partial

import numpy as np

from evidence.hardware.arms import (
    Arm,
    JointKeys,
    Motion,
    Read,
    Run,
    friction,
    motor_current,
)
from evidence.hardware.data_set import DataSet

N = 7
STEP_S = 1e-3  # of the log's counter
SENSOR, CURRENT = 22, 29  # first columns of "TorqueSm" and "TorqueCur"
# The gripper as the controller knows it: the torques that it computes itself (columns "Torque")
# agree with the arm without its camera and 0.92 kg at 60 mm from the flange; Robotiq states
# 0.925 kg and 58 mm for the 2F-85.
GRIPPER_KG = 0.925
LINKS = 10  # the URDF's first links: world, base and the arm's; the others are of a gripper
# Kinova's link without a camera; the repository's URDF has the one with it (0.5 kg)
BRACELET = {"mass": "0.364", "com": "-0.000093 0.000132 -0.022905"}
_BRACELET_INERTIA = {"ixx": "0.000214", "ixy": "0", "ixz": "1E-06"}
_BRACELET_INERTIA |= {"iyy": "0.000223", "iyz": "-2E-06", "izz": "0.00024"}
_URDF = "robots/kinovaGen3.urdf"
_SHA256 = {
    "joint_2_trapez": "03395d0eab42fced8a31bed09f3dfe89a3c471751f364590c48a9ac5a1a926be",
    "joint_4_trapez": "2f981fd8c9ddd2aaed3631ff064c0cc0cadd118bbfa40f5ca03162cc41a50be5",
    "opti_traj_testing1": "0c9229ae8882a43fb1aac59c1b527a0942a99dcb0fe2aed77e948091fe8bf274",
    "opti_traj_testing2": "e8e27ef2f4943a3a5b3632c319731473747507e58a512b29adde48a9d4769440",
}


def _path(run: str) -> str:
    folder = "jointwise_motion" if run.startswith("joint") else "validation_data"
    return f"data/kinova/{folder}/{run}.csv"


DATA = DataSet(
    what="Kinova Gen3 with a gripper, 1 kHz, torque sensors and currents: W. Chiha, DynaMapp",
    repository="wissem01chiha/dynamic-identification",
    commit="26cb5a05346b12f7a00e4089c62971edd3911a3a",
    licence="CC0-1.0",
    files={_path(run): own for run, own in _SHA256.items()},
)
MODEL = DataSet(
    what="its URDF",
    repository=DATA.repository,
    commit="44f47d5640d89c7b97e584bb10163c4a2b3ced00",
    licence="CC0-1.0",
    files={
        _URDF: "09748ecfb4a0cf543066346a64a24b9edb46207103a68047fd26241c1320fbc3",
    },
)


def _motion(run: str, first: int, read: Read) -> Motion:
    lines = read(DATA, _path(run)).decode().split()[1:]
    table = np.array([line.split(",")[: first + N] for line in lines], float)
    return Motion(STEP_S * table[:, 0], table[:, 1 : 1 + N], table[:, first : first + N])


def _urdf(read: Read) -> bytes:
    """Return the arm without gripper and camera; joints without end stops turn twice."""
    root = ET.fromstring(read(MODEL, _URDF))
    links = [link.get("name", "") for link in root.findall("link")][:LINKS]
    for part in list(root):
        child = part.find("child")
        name = part.get("name") if part.tag == "link" else child is not None and child.get("link")
        if name not in links:
            root.remove(part)
    for joint in root.findall("joint"):
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            limit = joint.find("limit")
            if limit is not None:
                limit.attrib |= {"lower": "-6.2832", "upper": "6.2832"}
    inertial = root.find("link[@name='bracelet_link']/inertial")
    if inertial is not None:
        for tag, attributes in (
            ("origin", {"xyz": BRACELET["com"]}),
            ("mass", {"value": BRACELET["mass"]}),
            ("inertia", _BRACELET_INERTIA),
        ):
            inertial.find(tag).attrib.update(attributes)  # type: ignore[union-attr]
    return ET.tostring(root)


def _run(run: str, kind: str, *, held: bool = False) -> Run:
    first = SENSOR if kind == "sensor" else CURRENT
    return Run(
        name=f"{run}-{kind}",
        payload_kg=GRIPPER_KG,
        motion=partial(_motion, run, first),
        held_out=held,
    )


JOINTS = [f"joint_{k + 1}" for k in range(N)]
LIMITS_NM = dict(zip(JOINTS, [39.0] * 4 + [9.0] * 3, strict=True))
ANGLE_NOISE_RAD = 1e-5


def _arm(kind: str, overlay: list[JointKeys], runs: list[Run]) -> Arm:
    return Arm(
        name=f"gen3-{kind}",
        data_sets=[DATA, MODEL],
        urdf=_urdf,
        tool="end_effector_link",
        guess_kg=1.0,
        rate_hz=1000.0,
        joints=JOINTS,
        sensor="motor_current" if kind == "current" else "arm_sensor",
        overlay={"robot": {"links_sigma_ratio": 0.2}, "joints": overlay},
        runs=runs,
    )


ARMS = (
    _arm(
        "current",
        motor_current(LIMITS_NM, ANGLE_NOISE_RAD),
        [
            _run("joint_2_trapez", "current"),
            _run("joint_4_trapez", "current"),
            _run("opti_traj_testing1", "current"),
            _run("opti_traj_testing2", "current", held=True),
        ],
    ),
    _arm(
        "sensor",
        friction(LIMITS_NM, ANGLE_NOISE_RAD),
        [
            _run("opti_traj_testing1", "sensor"),
            _run("opti_traj_testing2", "sensor", held=True),
        ],
    ),
)
