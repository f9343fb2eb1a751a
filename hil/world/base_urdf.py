"""Robot files for the flight side, without the true base if the base is unknown."""

from collections.abc import Callable, Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from hil.world.inertia import FloatArray
from hil.world.links import read_body

_KEYS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def replace_base(urdf: Path, root_report: FloatArray) -> str:
    """Return the text of a URDF whose root link has the given inertial data.

    The robot file that the flight side reads must not hold the truth of an unknown base.
    """
    tree = ElementTree.parse(urdf)
    root = tree.getroot()
    children = {child.get("link") for child in root.iter("child")}
    link = next(e for e in root.iter("link") if e.get("name") not in children)
    for old in link.findall("inertial"):
        link.remove(old)
    _write(ElementTree.SubElement(link, "inertial"), root_report)
    return ElementTree.tostring(root, encoding="unicode")


def change_links(urdf: str, changes: Mapping[str, Callable[[FloatArray], FloatArray]]) -> str:
    """Return a URDF's text with new inertial data; `changes` maps a link's report to a new one."""
    root = ElementTree.fromstring(urdf)
    for link in root.iter("link"):
        inertial = link.find("inertial")
        if inertial is not None and (name := link.get("name", "")) in changes:
            body = read_body(inertial)
            report = np.array([body.mass_kg, *body.com_m, *body.inertia_kg_m2])
            report = changes[name](report)
            inertial.clear()
            _write(inertial, report)
    return ElementTree.tostring(root, encoding="unicode")


def _write(inertial: ElementTree.Element, report: FloatArray) -> None:
    text = [repr(float(x)) for x in report]
    ElementTree.SubElement(inertial, "origin", xyz=" ".join(text[1:4]), rpy="0 0 0")
    ElementTree.SubElement(inertial, "mass", value=text[0])
    ElementTree.SubElement(inertial, "inertia", dict(zip(_KEYS, text[4:], strict=True)))


def child_links(urdf: str) -> list[str]:
    """Return the names of all links of a URDF but the root."""
    return [str(child.get("link")) for child in ElementTree.fromstring(urdf).iter("child")]
