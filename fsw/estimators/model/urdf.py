"""The part of a URDF that the dynamics need, in the form that the library reads.

Shapes and materials are left out, so that faults in them matter to pictures and collisions only. A
continuous joint becomes a revolute one without limits of position: for the library it would have
two coordinates, cosine and sine, and sensors measure one angle.
"""

import xml.etree.ElementTree as ET

UNLIMITED = 1e9  # a limit of at least this size is no limit; the library reads no infinity
_PARTS = ("parent", "child", "origin", "axis", "dynamics")  # of a joint; the limit apart
_ENDLESS = {"lower": f"{-UNLIMITED}", "upper": f"{UNLIMITED}"}
_LIMITS = {"effort": f"{UNLIMITED}", "velocity": f"{UNLIMITED}"}  # of a joint without <limit>


def dynamics_of(text: str | bytes) -> str:
    """Return the URDF `text` with inertias and joints only, each with one coordinate at most.

    Raises
    ------
    xml.etree.ElementTree.ParseError if the text is not XML.
    """
    root = ET.fromstring(text)
    kept = ET.Element(root.tag, name=root.get("name", ""))
    for link in root.findall("link"):
        ET.SubElement(kept, "link", link.attrib).extend(link.findall("inertial"))
    for joint in root.findall("joint"):
        own = ET.SubElement(kept, "joint", joint.attrib)
        own.extend(part for part in joint if part.tag in _PARTS)
        limit = joint.find("limit")
        given = {} if limit is None else limit.attrib
        if joint.get("type") == "continuous":
            own.set("type", "revolute")
            given = _LIMITS | given | _ENDLESS
        if given:
            ET.SubElement(own, "limit", {key: _bounded(value) for key, value in given.items()})
    return ET.tostring(kept, encoding="unicode")


def _bounded(value: str) -> str:
    """Return a number within the bound as text; text that is not a number stays as it is."""
    try:
        return repr(min(max(float(value), -UNLIMITED), UNLIMITED))
    except ValueError:
        return value
