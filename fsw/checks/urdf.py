"""Check a URDF before the library reads it: size, UTF-8, tree of links, plausible numbers.

The library recurses through links and elements, and thousands of them crash the process. It also
accepts numbers that no robot has.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from math import inf, isnan

from fsw.config.base import MAX_INERTIA_KG_M2, MAX_LENGTH_M, MAX_MASS_KG
from fsw.config.text import URDF, kind_of
from fsw.errors import ConfigError, brief

MAX_BYTES = 1 << 20
MAX_LINKS = 128
MAX_ELEMENTS = 20_000
MAX_DEPTH = 32
_INERTIA = dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), MAX_INERTIA_KG_M2)
_LIMIT = dict.fromkeys(("lower", "upper", "effort", "velocity"), inf)  # 1e16 and inf: no limit
LARGEST: dict[str, dict[str, float]] = {  # largest absolute value by element and attribute
    "origin": {"xyz": MAX_LENGTH_M, "rpy": 6.3},
    "mass": {"value": MAX_MASS_KG},
    "inertia": _INERTIA,
    "axis": {"xyz": 1e6},
    "limit": _LIMIT,
}


class _Bounded(ET.TreeBuilder):
    """Builds the tree of a document; raises ConfigError for a document type or a broken bound."""

    def __init__(self) -> None:
        super().__init__()
        self._depth = self._elements = 0

    def doctype(self, *_words: object) -> None:
        raise ConfigError("has a document type; URDF has none; is it a web page?")

    def start(self, tag: str, attrs: dict[str, str], /) -> ET.Element:
        self._depth += 1
        self._elements += 1
        if self._depth > MAX_DEPTH:
            raise ConfigError(f"has elements nested deeper than {MAX_DEPTH}")
        if self._elements > MAX_ELEMENTS:
            raise ConfigError(f"has more than {MAX_ELEMENTS} elements")
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> ET.Element:
        self._depth -= 1
        return super().end(tag)


def check_urdf(content: bytes) -> None:
    """Check the content of a URDF file as far as possible without the URDF library.

    Raises
    ------
    ConfigError with a text that the caller puts after the file's name.
    """
    if (kind := kind_of(content)) not in ("", URDF):
        raise ConfigError(f"is {kind}, no URDF")
    if len(content) > MAX_BYTES:
        raise ConfigError(f"has {len(content)} bytes; must be at most {MAX_BYTES}")
    try:
        content.decode()
    except ValueError as error:
        raise ConfigError("is not in UTF-8; save it as UTF-8, without another encoding") from error
    try:
        root = ET.fromstring(content, ET.XMLParser(target=_Bounded(), encoding="utf-8"))
    except (ET.ParseError, ValueError) as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f"is not a URDF: {error}") from error
    if root.tag != "robot":
        raise ConfigError(f"is not a URDF: its root is <{brief(root.tag)}>, not <robot>")
    if any("xacro" in own.tag or _is_macro(own.attrib.values()) for own in root.iter()):
        raise ConfigError("is a xacro file, not a URDF; make one: xacro robot.xacro > robot.urdf")
    links = root.findall("link")
    if len(links) > MAX_LINKS:
        raise ConfigError(f"has {len(links)} links; must be at most {MAX_LINKS}")
    _check_numbers(root)
    _check_joints(root)


def _is_macro(values: Iterable[str]) -> bool:
    """Return whether xacro would replace a part of an attribute."""
    return any("${" in value or "$(" in value for value in values)


def _check_numbers(root: ET.Element) -> None:
    """Raise ConfigError for numbers that no robot has; other words are left to the library."""
    for element in root.iter():
        for name, largest in LARGEST.get(element.tag, {}).items():
            for word in element.get(name, "").split():
                try:
                    value = float(word)
                except ValueError:
                    continue
                if name in ("effort", "velocity") and value < 0.0:
                    raise ConfigError(f"has {name} {brief(word)} in <limit>; must be at least 0")
                if isnan(value) or abs(value) > largest:
                    bound = f"finite and within {largest:g} (metres, kilograms, radians)"
                    raise ConfigError(
                        f"has {name} {brief(word)} in <{element.tag}>; must be "
                        f"{'a number' if largest == inf else bound}"
                    )


def _check_joints(root: ET.Element) -> None:
    children: set[str] = set()
    for joint in root.findall("joint"):
        kind, name = joint.get("type"), brief(joint.get("name"))
        child = joint.find("child")
        link = "" if child is None else child.get("link", "")
        if link in children:
            raise ConfigError(f"joins the link {brief(link)} to more than one parent")
        children.add(link)
        moves = kind in ("revolute", "continuous", "prismatic")
        if not joint.get("name"):
            raise ConfigError(f"has a joint to {brief(link)} without a name")
        if joint.find("parent") is not None and not moves and kind != "fixed":
            base = "; of the base: leave out this joint and its parent" * (kind == "floating")
            raise ConfigError(
                f"joint {name} is {brief(kind)}; must be continuous, revolute, prismatic or fixed"
                f"{base}"
            )
        mimic = joint.find("mimic")
        if moves and mimic is not None:
            raise ConfigError(
                f"joint {name} mimics another, {brief(mimic.get('joint'))}; every joint needs a "
                "sensor of its own: take <mimic> out if it has one; if both are held still, as the "
                "fingers of a gripper, write them as fixed, each <origin> where it is held"
            )
        axis = joint.find("axis")
        if moves and axis is not None and not _is_direction(axis.get("xyz", "")):
            raise ConfigError(
                f"joint {name} has the axis {brief(axis.get('xyz'))}; must be three numbers, not "
                "all zero"
            )
        if moves and kind != "continuous" and joint.find("limit") is None:
            raise ConfigError(
                f"joint {name} has no <limit>; a {kind} joint needs lower, upper, effort and "
                "velocity"
            )


def _is_direction(text: str) -> bool:
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        return False
    return len(numbers) == 3 and 1e-6 < max(map(abs, numbers), default=0.0) < inf
