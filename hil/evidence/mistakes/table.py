"""The mistakes: each one changes the flight configuration or the robot file, and nothing else.

A mistake changes the document of a correct configuration in place, as a user might have written
it. The text of the robot file is under the document's key `_urdf`.
"""

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from hil.world.base_urdf import change_links, child_links
from hil.world.inertia import FloatArray

Document = dict[str, Any]
ALL = range(64)  # all joints of any robot
Change = Callable[[Document], None]


def mistakes() -> Mapping[str, Change]:
    """Return the mistakes by name; the first one changes nothing."""
    return {
        "none": lambda _: None,
        "sign of joint 2": _sign(1),
        "joints 3 and 4 swapped": _swapped(2, 3),
        "zero of joint 2 off 0.05 deg": _zeros([1], 0.05),
        "zero of joint 2 off 0.5 deg": _zeros([1], 0.5),
        "zero of joint 4 off 5 deg": _zeros([3], 5.0),
        "all zeros off 0.5 deg": _zeros(ALL, 0.5),
        "IMU turned 0.1 deg": _turned(0.1),
        "IMU turned 2 deg": _turned(2.0),
        "IMU turned 90 deg": _turned(90.0),
        "lever arm off 0.2 m": _lever(0.2),
        "IMU group delay off 20 ms": _delay(0.02),
        "quaternion order of the IMU": _order,
        "link 4 off 20 %": _links(1.2, [3]),
        "all links off 1 %": _links(1.01),
        "all links off 20 %": _links(1.2),
        "known base off 1 %": _base(1.01),
        "known base off 20 %": _base(1.2),
        "torque gain of joint 2 off 5 %": _gain([1], 1.05),
        "torque gain of all off 0.5 %": _gain(ALL, 1.005),
        "torque gain of all off 5 %": _gain(ALL, 1.05),
        "noise declared ten times too small": _noise(0.1),
        "prior wrong and tight": _prior(1.5, 0.02),
    }


def wrong(name: str, document: Mapping[str, Any], urdf: str) -> tuple[Document, str]:
    """Return copies of a flight configuration and of the robot file's text with a mistake.

    `name` is the mistake. The arguments stay unchanged.
    """
    changed = copy.deepcopy(dict(document)) | {"_urdf": urdf}
    mistakes()[name](changed)
    text: str = changed.pop("_urdf")
    return changed, text


def _sign(joint: int) -> Change:
    def change(document: Document) -> None:
        document["joints"][joint]["sign"] *= -1

    return change


def _swapped(first: int, second: int) -> Change:
    def change(document: Document) -> None:
        one, other = document["joints"][first], document["joints"][second]
        one["node_id"], other["node_id"] = other["node_id"], one["node_id"]

    return change


def _zeros(joints: Sequence[int], degrees: float) -> Change:
    def change(document: Document) -> None:
        for k in joints[: len(document["joints"])]:
            document["joints"][k]["zero_offset_rad"] += math.radians(degrees)

    return change


def _turned(degrees: float) -> Change:
    def change(document: Document) -> None:
        mounting = document["imu"]["mounting"]
        by = Rotation.from_rotvec(math.radians(degrees) * np.array([2.0, -1.0, 2.0]) / 3.0)
        mounting["q_BS_xyzw"] = (by * Rotation.from_quat(mounting["q_BS_xyzw"])).as_quat().tolist()

    return change


def _lever(metres: float) -> Change:
    def change(document: Document) -> None:
        mounting = document["imu"]["mounting"]
        off = metres * np.array([2.0, 1.0, -2.0]) / 3.0
        mounting["p_BS_m"] = (np.array(mounting["p_BS_m"]) + off).tolist()

    return change


def _delay(seconds: float) -> Change:
    def change(document: Document) -> None:
        for key in ("gyro_group_delay_s", "acc_group_delay_s"):
            document["imu"][key] += seconds

    return change


def _order(document: Document) -> None:
    mounting = document["imu"]["mounting"]
    x, y, z, w = mounting["q_BS_xyzw"]
    mounting["q_BS_xyzw"] = [w, x, y, z]


def _links(factor: float, only: Sequence[int] = ALL) -> Change:
    def heavier(report: FloatArray) -> FloatArray:
        return np.concatenate([[factor * report[0]], report[1:4], factor * report[4:]])

    def change(document: Document) -> None:
        urdf = document["_urdf"]
        names = [name for k, name in enumerate(child_links(urdf)) if k in only]
        document["_urdf"] = change_links(urdf, dict.fromkeys(names, heavier))

    return change


def _base(factor: float) -> Change:
    def change(document: Document) -> None:
        if "base" in document["unknown"]:
            return
        base = document["bodies"]["base"]
        base["mass_kg"] *= factor
        base["inertia_kg_m2"] = [factor * x for x in base["inertia_kg_m2"]]

    return change


def _gain(joints: Sequence[int], factor: float) -> Change:
    def change(document: Document) -> None:
        for k in joints[: len(document["joints"])]:
            document["joints"][k]["torque_gain"] = factor

    return change


def _noise(factor: float) -> Change:
    def change(document: Document) -> None:
        for joint in document["joints"]:
            joint["torque_noise_nm"] *= factor
            joint["position_noise_rad"] *= factor
        for key in ("angle_random_walk_rad_sqrt_s", "velocity_random_walk_m_s_sqrt_s"):
            document["imu"][key] *= factor

    return change


def _prior(factor: float, sigma_ratio: float) -> Change:
    def change(document: Document) -> None:
        for name in document["unknown"]:
            body = document["bodies"][name]
            body["mass_kg"] *= factor
            body["sigma"]["mass_kg"] = sigma_ratio * body["mass_kg"]

    return change
