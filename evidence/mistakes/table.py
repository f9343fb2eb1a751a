"""The mistakes: each changes the flight configuration, the robot file or the readings of devices.

A mistake changes the document of a correct configuration in place, as a user might have written
it, or the readings of correct devices. The text of the robot file is under the document's key
`_urdf`. `words` are those by which `fsw check`, or `fsw import` before it, names the mistake.
"""

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from evidence.mistakes.readings import Readings
from evidence.mistakes.recording import ASKED
from hil.world.base_urdf import change_links, child_links
from hil.world.inertia import FloatArray

Document = dict[str, Any]
ALL = range(64)  # all joints of any robot
Change = Callable[[Document], None]
NONE, NONE_WIRED = "none", "none, joints described"
G_M_S2 = 9.80665
ROTOR_KG_M2, ROTOR_SAMPLES = 1.0, 11
FRICTION_NM, FRICTION_NMS_RAD, FRICTION_RAD_S = 0.5, 0.8, 0.01


def _as_they_are(readings: Readings) -> Readings:
    return readings


@dataclass(frozen=True, slots=True, kw_only=True)
class Mistake:
    """A change of the configuration and of the readings, and words for it."""

    change: Change = lambda _: None
    readings: Callable[[Readings], Readings] = _as_they_are
    words: tuple[str, ...] = ()  # one of them names the mistake
    wired: Change | None = None  # of a configuration that describes the joints' frames


def mistakes() -> Mapping[str, Mistake]:
    """Return the mistakes by name; the first one changes nothing."""
    return {NONE: Mistake(), **_configurations(), **_readings(), **wirings()}


def _configurations() -> Mapping[str, Mistake]:
    zero, links = ("zero_offset_rad of joints",), ("masses and inertias of the robot's links",)
    mounting, gain = ("imu.mounting",), ("torque_gain of joints", "torque_gain")
    base = ("the known base", *links)
    rows: Mapping[str, tuple[Change, tuple[str, ...]]] = {
        "sign of joint 2": (_sign(1), ("joints.1.sign",)),
        "joints 3 and 4 swapped": (_swapped(2, 3), ("joints.2.node_id and joints.3.node_id",)),
        "zero of joint 2 off 0.05 deg": (_zeros([1], 0.05), zero),
        "zero of joint 2 off 0.5 deg": (_zeros([1], 0.5), zero),
        "zero of joint 4 off 5 deg": (_zeros([3], 5.0), zero),
        "all zeros off 0.5 deg": (_zeros(ALL, 0.5), zero),
        "IMU turned 0.1 deg": (_turned(0.1), mounting),
        "IMU turned 2 deg": (_turned(2.0), mounting),
        "IMU turned 90 deg": (_turned(90.0), mounting),
        "lever arm off 0.2 m": (_lever(0.2), ("imu.mounting.p_BS_m",)),
        "IMU group delay off 20 ms": (_delay(0.02), ("imu: its clock differs",)),
        "quaternion order of the IMU": (_order, ("order w x y z", "Set q_BS_xyzw")),
        "link 4 off 20 %": (_links(1.2, [3]), links),
        "all links off 1 %": (_links(1.01), links),
        "all links off 20 %": (_links(1.2), links),
        "known base off 1 %": (_base(1.01), base),
        "known base off 20 %": (_base(1.2), base),
        "torque gain of joint 2 off 5 %": (_gain([1], 1.05), gain),
        "torque gain of all off 0.5 %": (_gain(ALL, 1.005), gain),
        "torque gain of all off 5 %": (_gain(ALL, 1.05), gain),
        "noise declared ten times too small": (_noise(0.1), ("the data are noisier",)),
        "noise declared 1.6 times too small": (_noise(1.0 / 1.6), ("the data are noisier",)),
        "prior wrong and tight": (_prior(1.5, 0.02), ("the prior",)),
        "gravity of the other sign": (_gravity, ("gravity points the other way",)),
        "window of 4 s": (_window(4.0), ("window too long for this motion",)),
    }
    return {name: Mistake(change=change, words=words) for name, (change, words) in rows.items()}


def _readings() -> Mapping[str, Mistake]:
    torque_units = ("1000 times too", "torque_limit_nm", "beyond", ASKED)
    rows: Mapping[str, tuple[Callable[[Readings], Readings], tuple[str, ...]]] = {
        "all torques reversed": (_scaled("torque", -1.0), ("all torques count the other way",)),
        "all positions reversed": (_scaled("position", -1.0), ("all positions count the other",)),
        "torques of joints 2 and 3 exchanged": (_exchanged("torque"), ("torques are exchanged",)),
        "angles of joints 2 and 3 exchanged": (
            _exchanged("position"),
            ("positions are exchanged",),
        ),
        "friction not declared": (_rubbed, ("friction that is not declared",)),
        "torques 10 ms late": (_late("t_torque_s", 0.01), ("stamps of torques and positions",)),
        "IMU 10 ms late": (_late("t_imu_s", 0.01), ("imu: its clock differs",)),
        "IMU 30 ms early": (_late("t_imu_s", -0.03), ("imu: its clock differs",)),
        "IMU 0.9 s late": (_late("t_imu_s", 0.9), ("imu: its clock differs",)),
        "specific force in g": (_scaled("force", 1.0 / G_M_S2), ("specific force is in g",)),
        "rates in deg/s": (
            _scaled("rate", math.degrees(1.0)),
            ("rates are in degrees", "beyond", ASKED),
        ),
        "angles in degrees": (
            _scaled("position", math.degrees(1.0)),
            ("angles are in degrees", ASKED),
        ),
        "torques in mN m": (_scaled("torque", 1e3), torque_units),
        "torques in kN m": (_scaled("torque", 1e-3), torque_units),
        "angles wrap at pi": (_wrapped, ("angle wraps", "wrap")),
    }
    return {name: Mistake(readings=change, words=words) for name, (change, words) in rows.items()}


def wirings() -> Mapping[str, Mistake]:
    """Return the mistakes in the description of the joints' frames; the first one has none."""
    too = ("angle is 57.3 times too",)
    torque = ("joints.1.signals.torque", "torque_limit_nm")
    reversed_ = ("its torque alone counts the other way",)
    rows: Mapping[str, tuple[Change, tuple[str, ...]]] = {
        NONE_WIRED: (lambda _: None, ()),
        "described: joint 2 in deg read as rad": (_signal("angle", unit="rad"), too),
        "described: joint 2 in rad read as deg": (
            _signal("angle", scale=1e-4 * math.pi / 180.0),
            too,
        ),
        "described: torque 2 in mN m": (_signal("torque", scale=10.0), torque),
        "described: torque 2 per mille of 40": (_signal("torque", scale=0.25), torque),
        "described: angle 2 in other byte order": (
            _signal("angle", order="big", start=7),
            ("in little-endian byte order",),
        ),
        "described: torque 2 in other byte order": (
            _signal("torque", order="big", start=39),
            ("in little-endian byte order",),
        ),
        "described: torque 2 unsigned": (
            _signal("torque", number="unsigned"),
            ("as a signed number",),
        ),
        "described: torque 2 counts the other way": (_signal("torque", scale=-1e-2), reversed_),
        "described: torques 3 and 4 swapped": (
            _torques_swapped,
            ("their torques are exchanged",),
        ),
        "described: joints 3 and 4 swapped": (
            _messages_swapped,
            ("joints.2.signals and joints.3.signals",),
        ),
    }
    found = {name: Mistake(wired=change, words=words) for name, (change, words) in rows.items()}
    as_it_is: Change = lambda _: None  # noqa: E731
    return found | {
        "described: torque of the motor as link's": Mistake(
            wired=as_it_is, readings=_of_motor, words=("those of the motors", "friction that")
        ),
        "described: values of the period before": Mistake(
            wired=as_it_is, readings=_period_before, words=("one period of bus", "imu: its clock")
        ),
        "described: torques of the period before": Mistake(
            wired=as_it_is,
            readings=_torques_before,
            words=("stamps of torques and positions",),
        ),
    }


def _signal(name: str, **changes: object) -> Change:
    """Return a change of a signal of joint 2."""

    def change(document: Document) -> None:
        signals = document["buses"][0]["messages"][1]["signals"]
        next(own for own in signals if own["name"] == name).update(changes)

    return change


def _messages_swapped(document: Document) -> None:
    one, other = (document["joints"][k]["signals"] for k in (2, 3))
    document["joints"][2]["signals"], document["joints"][3]["signals"] = other, one


def _torques_swapped(document: Document) -> None:
    one, other = (document["joints"][k]["signals"] for k in (2, 3))
    one["torque"], other["torque"] = other["torque"], one["torque"]


def _of_motor(readings: Readings) -> Readings:
    """Return the readings with friction and rotor inertia in the torques."""
    speed = np.gradient(readings.position, readings.t_joint_s, axis=0)
    smooth = uniform_filter1d(speed, ROTOR_SAMPLES, axis=0)
    acceleration = np.gradient(smooth, readings.t_joint_s, axis=0)
    rubbed = _rubbed(readings)
    return replace(rubbed, torque=rubbed.torque + ROTOR_KG_M2 * acceleration)


def _period_before(readings: Readings) -> Readings:
    """Return the readings with the joints' values of one sample earlier."""
    before = _torques_before(readings)
    return replace(before, position=np.concatenate([readings.position[:1], readings.position[:-1]]))


def _torques_before(readings: Readings) -> Readings:
    """Return the readings with the torques of one sample earlier."""
    return replace(readings, torque=np.concatenate([readings.torque[:1], readings.torque[:-1]]))


def wrong(name: str, document: Mapping[str, Any], urdf: str) -> tuple[Document, str]:
    """Return copies of a flight configuration and of the robot file's text with a mistake.

    `name` is the mistake. The arguments stay unchanged.
    """
    changed = copy.deepcopy(dict(document)) | {"_urdf": urdf}
    mistakes()[name].change(changed)
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


def _gravity(document: Document) -> None:
    if "base" in document and "gravity_B_m_s2" in document["base"]:
        down = document["base"]["gravity_B_m_s2"]
        document["base"]["gravity_B_m_s2"] = [-value for value in down]


def _window(seconds: float) -> Change:
    def change(document: Document) -> None:
        document["estimator"] = {**document.get("estimator", {}), "window_s": seconds}

    return change


def _scaled(name: str, factor: float) -> Callable[[Readings], Readings]:
    return lambda readings: replace(readings, **{name: factor * getattr(readings, name)})


def _late(name: str, seconds: float) -> Callable[[Readings], Readings]:
    return lambda readings: replace(readings, **{name: seconds + getattr(readings, name)})


def _exchanged(name: str) -> Callable[[Readings], Readings]:
    def change(readings: Readings) -> Readings:
        values = getattr(readings, name).copy()
        values[:, [1, 2]] = values[:, [2, 1]]
        return replace(readings, **{name: values})

    return change


def _rubbed(readings: Readings) -> Readings:
    speed = np.gradient(readings.position, readings.t_joint_s, axis=0)
    coulomb = FRICTION_NM * np.tanh(speed / FRICTION_RAD_S)
    return replace(readings, torque=readings.torque + coulomb + FRICTION_NMS_RAD * speed)


def _wrapped(readings: Readings) -> Readings:
    """Return the readings with joint 1 a turn lower where it is above its median."""
    position = readings.position.copy()
    position[:, 0] -= 2.0 * math.pi * (position[:, 0] > np.median(position[:, 0]))
    return replace(readings, position=position)
