"""A force-torque sensor as part of the robot: six joints that never move.

The sensor stands between a link and the joint that moves it. Three prismatic and three revolute
joints along the axes of S, all at zero, leave the link where it is. Their generalised forces are
the force and the moment about the origin of S by which the sensor holds everything beyond. The
recursion for joint torques and its derivatives therefore gives the wrench and its derivatives too.
"""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from fsw.errors import ConfigError

AXES = ("fx", "fy", "fz", "tx", "ty", "tz")
_LIMIT = {"lower": "-1", "upper": "1", "effort": "1", "velocity": "1"}  # never used


@dataclass(frozen=True, slots=True, kw_only=True)
class WrenchSensor:
    """Place of one sensor.

    Attributes
    ----------
    name : name of the sensor
    key : configuration key of `frame`
    frame : link that the sensor carries, or the joint that moves this link
    p_FS_m, rpy_FS_rad : origin and axes of S in the frame of that link
    """

    name: str
    key: str
    frame: str
    p_FS_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy_FS_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def axes(self) -> tuple[str, ...]:
        """Return the names of the six axes."""
        return tuple(f"{self.name}.{axis}" for axis in AXES)

    @property
    def units(self) -> dict[str, str]:
        """Return the unit of every axis."""
        return dict(zip(self.axes, ["N"] * 3 + ["N m"] * 3, strict=True))


def with_sensors(text: str, sensors: Sequence[WrenchSensor]) -> str:
    """Return the URDF `text` with the six joints of every sensor.

    Raises
    ------
    ConfigError if the URDF has no such link or joint, or no joint moves the link.
    """
    if not sensors:
        return text
    root = ET.fromstring(text)
    for sensor in sensors:
        _insert(root, sensor)
    return ET.tostring(root, encoding="unicode")


def _insert(root: ET.Element, sensor: WrenchSensor) -> None:
    child = _carrying(root, sensor)
    link, stub = child.get("link", ""), f"{sensor.name}.stub"
    child.set("link", stub)
    ET.SubElement(root, "link", name=stub)
    R = pin.rpy.rpyToMatrix(*sensor.rpy_FS_rad)
    back = pin.SE3(R, np.array(sensor.p_FS_m)).inverse()
    parent, place = stub, (sensor.p_FS_m, sensor.rpy_FS_rad)
    for k, axis in enumerate(sensor.axes):
        own = _joint(root, axis, "revolute" if k >= 3 else "prismatic", parent, f"{axis}.link")
        if k == 0:
            _origin(own, *place)
        ET.SubElement(own, "axis", xyz=" ".join("1" if k % 3 == i else "0" for i in range(3)))
        ET.SubElement(own, "limit", _LIMIT)
        parent = f"{axis}.link"
        ET.SubElement(root, "link", name=parent)
    own = _joint(root, f"{sensor.name}.back", "fixed", parent, link)
    _origin(own, back.translation, pin.rpy.matrixToRpy(back.rotation))


def _carrying(root: ET.Element, sensor: WrenchSensor) -> ET.Element:
    """Return the element `child` of the joint that moves the sensor's link."""
    joints = {joint.get("name"): joint for joint in root.findall("joint")}
    movers = {_child(joint).get("link"): joint for joint in joints.values()}
    joint = movers.get(sensor.frame)
    links = [link.get("name") for link in root.findall("link")]
    if joint is None and sensor.frame in links:
        raise ConfigError(
            f"{sensor.key}: {sensor.frame!r} is the root link, which no sensor carries; it has "
            f"{sorted(str(link) for link in movers)}"
        )
    joint = joint or joints.get(sensor.frame)
    if joint is None:
        raise ConfigError(f"{sensor.key}: {sensor.frame!r} is not a link; the robot has {links}")
    return _child(joint)


def _child(joint: ET.Element) -> ET.Element:
    found = joint.find("child")
    return ET.Element("child") if found is None else found


def _joint(root: ET.Element, name: str, kind: str, parent: str, child: str) -> ET.Element:
    made = ET.SubElement(root, "joint", name=name, type=kind)
    ET.SubElement(made, "parent", link=parent)
    ET.SubElement(made, "child", link=child)
    return made


def _origin(joint: ET.Element, p_m: Sequence[float], rpy_rad: Sequence[float]) -> None:
    values = {"xyz": p_m, "rpy": rpy_rad}
    own = {key: " ".join(repr(float(x)) for x in value) for key, value in values.items()}
    ET.SubElement(joint, "origin", own)
