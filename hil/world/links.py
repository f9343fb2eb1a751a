"""The links of a URDF and their bodies, as its file and a file of bodies have them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Body:
    """Inertial data of a rigid body in its own frame; inertia about the centre of mass."""

    mass_kg: float
    com_m: tuple[float, float, float]
    inertia_kg_m2: tuple[float, float, float, float, float, float]  # xx xy xz yy yz zz


def body_of(report: FloatArray) -> Body:
    """Return the body of a report (10,)."""
    mass, cx, cy, cz, xx, xy, xz, yy, yz, zz = (float(x) for x in report)
    return Body(mass, (cx, cy, cz), (xx, xy, xz, yy, yz, zz))


@dataclass(frozen=True, slots=True)
class Link:
    """One URDF link and the joint that carries it; `axis` is None if the joint is fixed."""

    name: str
    parent: str | None
    body: Body | None
    p_PL_P_m: tuple[float, float, float]
    q_PL_xyzw: tuple[float, float, float, float]
    joint: str
    axis: tuple[float, float, float] | None
    is_prismatic: bool  # if true, limits and effort are in m, m/s and N
    lower_rad: float
    upper_rad: float
    effort_nm: float
    speed_rad_s: float


def load_bodies(path: Path) -> dict[str, Body]:
    """Read a YAML mapping of body names to mass_kg, com_m, inertia_kg_m2."""
    document = yaml.safe_load(path.read_text(encoding="utf-8"))
    bodies = {}
    for name, entry in document.items():
        com = [float(x) for x in entry["com_m"]]
        inertia = [float(x) for x in entry["inertia_kg_m2"]]
        if len(com) != 3 or len(inertia) != 6:
            raise ValueError(f"{path}: {name}: com_m needs 3 and inertia_kg_m2 6 values")
        bodies[str(name)] = Body(float(entry["mass_kg"]), tuple(com), tuple(inertia))  # type: ignore[arg-type]
    return bodies


def read_links(urdf: Path) -> list[Link]:
    """Return the links of a URDF, depth first from the root; branches in order of joint name.

    Raises
    ------
    ValueError if there is not exactly one root, or the kind of a joint is unknown.
    """
    root = ElementTree.parse(urdf).getroot()
    joints = {_attribute(j, "child", "link"): j for j in root.findall("joint")}
    elements = {str(e.get("name")): e for e in root.findall("link")}
    roots = [name for name in elements if name not in joints]
    if len(roots) != 1:
        raise ValueError(f"{urdf}: must have one root link, has {roots}")
    ordered: list[Link] = []
    waiting = [roots[0]]
    while waiting:
        name = waiting.pop(0)
        ordered.append(_read_link(urdf, elements[name], joints.get(name)))
        beyond = [j for j in root.findall("joint") if _attribute(j, "parent", "link") == name]
        beyond.sort(key=lambda joint: str(joint.get("name")))
        waiting[:0] = [str(_attribute(joint, "child", "link")) for joint in beyond]
    return ordered


def with_base(links: Sequence[Link], base: Body | None) -> list[Link]:
    """Return the links, parents first, with a body for the root and all that is fixed to it.

    None: each keeps its own.
    """
    if base is None:
        return list(links)
    root, *others = links
    own, fixed = [replace(root, body=base)], {root.name}
    for link in others:
        is_fixed = link.axis is None and link.parent in fixed
        fixed |= {link.name} if is_fixed else set()
        own.append(replace(link, body=None) if is_fixed else link)
    return own


def _read_link(urdf: Path, element: Element, joint: Element | None) -> Link:
    kind = "fixed" if joint is None else str(joint.get("type"))
    inertial = element.find("inertial")
    name = "" if joint is None else str(joint.get("name"))
    if kind not in ("revolute", "prismatic", "continuous", "fixed"):
        raise ValueError(f"{urdf}: joint {name!r} is {kind}; must be revolute, prismatic or fixed")
    p, R = _origin(joint)
    limit = None if joint is None else joint.find("limit")
    bounds = {} if limit is None else dict(limit.attrib)
    ranged = kind in ("revolute", "prismatic") and limit is not None
    axis = None
    if kind != "fixed":
        axis = _vector(_attribute(joint, "axis", "xyz"), "1 0 0")
    return Link(
        name=str(element.get("name")),
        parent=_attribute(joint, "parent", "link"),
        body=None if inertial is None else read_body(inertial),
        p_PL_P_m=p,
        q_PL_xyzw=tuple(R.as_quat()),
        joint=name,
        axis=axis,
        is_prismatic=kind == "prismatic",
        lower_rad=float(bounds.get("lower", 0.0)) if ranged else -np.inf,
        upper_rad=float(bounds.get("upper", 0.0)) if ranged else np.inf,
        effort_nm=float(bounds.get("effort", np.inf)),
        speed_rad_s=float(bounds.get("velocity", np.inf)),
    )


def read_body(inertial: Element) -> Body:
    """Return the body of an <inertial>, in the axes of its link."""
    com, R = _origin(inertial)
    tensor, mass = inertial.find("inertia"), _attribute(inertial, "mass", "value")
    if tensor is None or mass is None:
        raise ValueError("an <inertial> needs <mass value=...> and <inertia>")
    i = {key: float(value) for key, value in tensor.attrib.items()}
    local = np.array(
        [
            [i["ixx"], i["ixy"], i["ixz"]],
            [i["ixy"], i["iyy"], i["iyz"]],
            [i["ixz"], i["iyz"], i["izz"]],
        ]
    )
    turn = R.as_matrix()
    about_com = turn @ local @ turn.T
    xx, xy, xz, yy, yz, zz = about_com[np.triu_indices(3)].tolist()
    return Body(float(mass), com, (xx, xy, xz, yy, yz, zz))


def _origin(element: Element | None) -> tuple[tuple[float, float, float], Rotation]:
    xyz = _vector(_attribute(element, "origin", "xyz"), "0 0 0")
    rpy = _vector(_attribute(element, "origin", "rpy"), "0 0 0")
    return xyz, Rotation.from_euler("xyz", rpy)


def _attribute(element: Element | None, child: str, name: str) -> str | None:
    node = None if element is None else element.find(child)
    return None if node is None else node.get(name)


def _vector(text: str | None, default: str) -> tuple[float, float, float]:
    x, y, z = (float(part) for part in (text or default).split())
    return x, y, z


def link_of(urdf: Path, links: list[Link], frame: str) -> Link:
    """Return the link whose name or joint has this name. Raises ValueError if there is none."""
    link = next((k for k in links if frame in (k.name, k.joint)), None)
    if link is None:
        raise ValueError(f"{urdf}: no frame {frame!r}; has {[k.name for k in links]}")
    return link
