"""The robot file that the flight side reads: without the true base, where that is unknown."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

from hil.world.inertia import FloatArray


def replace_base(urdf: Path, root_report: FloatArray) -> str:
    """Return the text of a URDF whose root link has the given inertial data.

    An unknown base must not stand in the robot file the flight side reads.
    """
    tree = ElementTree.parse(urdf)
    root = tree.getroot()
    children = {child.get("link") for child in root.iter("child")}
    link = next(e for e in root.iter("link") if e.get("name") not in children)
    for old in link.findall("inertial"):
        link.remove(old)
    inertial = ElementTree.SubElement(link, "inertial")
    text = [repr(float(x)) for x in root_report]
    ElementTree.SubElement(inertial, "origin", xyz=" ".join(text[1:4]), rpy="0 0 0")
    ElementTree.SubElement(inertial, "mass", value=text[0])
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    ElementTree.SubElement(inertial, "inertia", dict(zip(keys, text[4:], strict=True)))
    return ElementTree.tostring(root, encoding="unicode")


def scale_links(urdf: str, factors: Mapping[str, float]) -> str:
    """Return the text of a URDF with mass and inertia of some links times a factor."""
    root = ElementTree.fromstring(urdf)
    for link in root.iter("link"):
        factor = factors.get(link.get("name", ""), 1.0)
        for element in (*link.iter("mass"), *link.iter("inertia")):
            for key, value in element.attrib.items():
                element.set(key, repr(factor * float(value)))
    return ElementTree.tostring(root, encoding="unicode")


def child_links(urdf: str) -> list[str]:
    """Return the names of all links of a URDF but the root."""
    return [str(child.get("link")) for child in ElementTree.fromstring(urdf).iter("child")]
