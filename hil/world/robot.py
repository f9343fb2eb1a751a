"""A free-floating base with one arm or several as a MuJoCo model, built from a URDF.

MuJoCo's own URDF import welds the root link to the world and fuses fixed links; here the root link
gets a free joint, every link stays a body, and a target is one more body welded to the tool frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import mujoco
import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hil.world.inertia import pi_of, report_of, symmetric
from hil.world.springs import Panel, SloshMass, Sprung
from hil.world.thrusters import ThrusterSystem
from hil.world.wheels import WheelSystem

FloatArray = NDArray[np.float64]

TARGET = "grasped target"  # name of the target's body in the model
BASE_NV = 6
BASE_NQ = 7


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


@dataclass(frozen=True, slots=True, eq=False)
class Robot:
    """The compiled model: 6 base velocities, slides, wheels, then n joints, parents first."""

    model: mujoco.MjModel
    joint_names: tuple[str, ...]
    lower_rad: FloatArray  # (n,) joint ranges of the URDF; infinite where it has none
    upper_rad: FloatArray
    effort_nm: FloatArray
    speed_rad_s: FloatArray
    is_prismatic: tuple[bool, ...]  # (n,)
    tool_id: int
    mount_p_BM_B_m: FloatArray  # (3,) base of the arm that grasps: frame of its first joint at zero
    mount_R_BM: FloatArray  # (3, 3)
    slides: tuple[Sprung, ...] = ()  # part of each slide or hinge coordinate, in order
    wheels: WheelSystem | None = None  # rotor coordinates follow those of the slides
    thrusters: ThrusterSystem | None = None

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @staticmethod
    def load(
        urdf: Path,
        tool_frame: str,
        base: Body | None = None,
        target: Body | None = None,
        slosh: Sequence[SloshMass] = (),
        held: Mapping[str, Body] | None = None,
        wheels: WheelSystem | None = None,
        thrusters: ThrusterSystem | None = None,
        panels: Sequence[Panel] = (),
    ) -> Robot:
        """Read a URDF and compile the model.

        Parameters
        ----------
        urdf : file whose root link is the base
        tool_frame : name of the link (or of the fixed joint) that grasps
        base : replaces the inertial data of the root link and of what is fixed to it
        target : grasped body, in the tool frame; None: nothing is grasped
        slosh, panels : parts of the base; their coordinates follow the base's
        held : further bodies, by the frame to which each is fixed
        wheels : reaction wheels; the base's inertial data include the locked wheels
        thrusters : thrusters of the base and their firings

        Raises
        ------
        ValueError if `read_links` rejects the file, a frame is missing, no joint moves the tool
        frame, or the base has no inertial data.
        """
        links = with_base(read_links(urdf), base)
        arm = [link for link in links if link.axis is not None]
        tool = link_of(urdf, links, tool_frame)
        grasped = [
            (link_of(urdf, links, frame).name, f"held by {frame}", body)
            for frame, body in (held or {}).items()
        ]
        if target is not None:
            grasped.append((tool.name, TARGET, target))
        grasping = _joints_to(links, tool)
        if not grasping:
            raise ValueError(f"{urdf}: no joint moves {tool.name!r}")
        if links[0].body is None:
            raise ValueError(f"{urdf}: root link {links[0].name!r} has no inertial data")
        parts: tuple[Sprung, ...] = (*slosh, *panels)
        model = _compile(links, grasped, parts, wheels)
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        first = model.body(grasping[0].name).id
        return Robot(
            model=model,
            joint_names=tuple(link.joint for link in arm),
            lower_rad=np.array([link.lower_rad for link in arm]),
            upper_rad=np.array([link.upper_rad for link in arm]),
            effort_nm=np.array([link.effort_nm for link in arm]),
            speed_rad_s=np.array([link.speed_rad_s for link in arm]),
            is_prismatic=tuple(link.is_prismatic for link in arm),
            tool_id=int(model.body(tool.name).id),
            mount_p_BM_B_m=data.xpos[first].copy(),
            mount_R_BM=data.xmat[first].reshape(3, 3).copy(),
            slides=tuple(part for part in parts for _ in part.axes),
            wheels=wheels,
            thrusters=thrusters,
        )

    def tool_poses(self, q_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the poses of the tool frame in the base frame.

        Parameters
        ----------
        q_rad : (k, n) joint positions

        Returns
        -------
        p_BE_B (k, 3) [m], R_BE (k, 3, 3)
        """
        data = mujoco.MjData(self.model)
        positions = np.empty((len(q_rad), 3))
        rotations = np.empty((len(q_rad), 3, 3))
        for k, q in enumerate(q_rad):
            data.qpos[-self.n :] = q
            mujoco.mj_kinematics(self.model, data)
            positions[k] = data.xpos[self.tool_id]
            rotations[k] = data.xmat[self.tool_id].reshape(3, 3)
        return positions, rotations


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


def _joints_to(links: list[Link], tool: Link) -> list[Link]:
    """Return the links with a moving joint on the path from the base to the tool."""
    by_name = {link.name: link for link in links}
    path: list[Link] = []
    link: Link | None = tool
    while link is not None:
        if link.axis is not None:
            path.insert(0, link)
        link = by_name[link.parent] if link.parent is not None else None
    return path


def without(body: Body, parts: Sequence[Sprung], wheels: WheelSystem | None = None) -> Body:
    """Return the rigid rest of a body without its liquid, panels (both at rest) and wheels.

    Raises
    ------
    ValueError if the rest is not a physical body.
    """
    if not parts and wheels is None:
        return body
    rotors = () if wheels is None else wheels.rotors
    inside_kg = sum(part.mass_kg for part in parts) + sum(rotor.mass_kg for rotor in rotors)
    if inside_kg >= body.mass_kg:
        raise ValueError(f"liquid, panels and wheels outweigh the base's {body.mass_kg} kg")
    whole = pi_of(np.array([body.mass_kg, *body.com_m, *body.inertia_kg_m2]))
    points = [part.pi for part in parts]
    points += [rotor.pi for rotor in rotors]
    rest = report_of(whole - np.sum(points, axis=0))
    moments = np.linalg.eigvalsh(symmetric(rest[4:]))
    if not (moments[0] > 0 and moments[0] + moments[1] >= moments[2]):
        raise ValueError(f"no rigid body is left of the base: moments {moments.round(3).tolist()}")
    return body_of(rest)


def _compile(
    links: list[Link],
    grasped: Sequence[tuple[str, str, Body]],
    parts: Sequence[Sprung],
    wheels: WheelSystem | None,
) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.fusestatic = False
    spec.compiler.alignfree = False
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    spec.option.gravity = [0.0, 0.0, 0.0]
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    bodies: dict[str, mujoco.MjsBody] = {}
    for link in links:
        parent = spec.worldbody if link.parent is None else bodies[link.parent]
        x, y, z, w = link.q_PL_xyzw
        node = parent.add_body(name=link.name, pos=link.p_PL_P_m, quat=[w, x, y, z])
        bodies[link.name] = node
        if link.body is not None:
            is_base = link.parent is None
            _set_inertia(node, without(link.body, parts, wheels) if is_base else link.body)
        if link.parent is None:
            node.add_joint(
                name="free",
                type=mujoco.mjtJoint.mjJNT_FREE,
                align=mujoco.mjtAlignFree.mjALIGNFREE_FALSE,
            )
            _add_sprung(node, parts)
            _add_wheels(node, wheels)
        elif link.axis is not None:
            axis = np.array(link.axis) / np.linalg.norm(link.axis)
            hinge, slide = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
            own = slide if link.is_prismatic else hinge
            node.add_joint(name=link.joint, type=own, axis=axis)
    for link_name, name, body in grasped:
        _set_inertia(bodies[link_name].add_body(name=name), body)
    return spec.compile()


def _add_sprung(base: mujoco.MjsBody, parts: Sequence[Sprung]) -> None:
    """Add the masses on springs; `hil.world.truth` computes springs and dampers."""
    for k, part in enumerate(parts):
        if isinstance(part, Panel):
            name, kind = f"panel {k}", mujoco.mjtJoint.mjJNT_HINGE
            body = Body(part.mass_kg, part.com_m, part.inertia_kg_m2)
        else:
            name, kind = f"liquid {k}", mujoco.mjtJoint.mjJNT_SLIDE
            speck = 1e-9 * part.mass_kg  # a point; MuJoCo needs a positive inertia
            body = Body(part.mass_kg, (0.0, 0.0, 0.0), (speck, 0, 0, speck, 0, speck))
        node = base.add_body(name=name, pos=part.place_m)
        _set_inertia(node, body)
        for axis in part.axes:
            node.add_joint(type=kind, axis=np.array(axis) / np.linalg.norm(axis))


def _add_wheels(base: mujoco.MjsBody, wheels: WheelSystem | None) -> None:
    """Add the rotors, each on a hinge at its centre; `hil.world.truth` computes the motors."""
    for k, rotor in enumerate(() if wheels is None else wheels.rotors):
        node = base.add_body(name=f"wheel {k}", pos=rotor.place_m)
        mass, _, _, _, *inertia = rotor.report.tolist()
        xx, xy, xz, yy, yz, zz = inertia
        _set_inertia(node, Body(mass, (0.0, 0.0, 0.0), (xx, xy, xz, yy, yz, zz)))
        node.add_joint(name=f"wheel {k}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=rotor.unit)


def _set_inertia(node: mujoco.MjsBody, body: Body) -> None:
    xx, xy, xz, yy, yz, zz = body.inertia_kg_m2
    node.explicitinertial = True
    node.mass = body.mass_kg
    node.ipos = body.com_m
    node.fullinertia = [xx, yy, zz, xy, xz, yz]
