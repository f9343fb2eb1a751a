"""A free-floating base with one arm or several as a MuJoCo model, built from a URDF.

MuJoCo's own URDF import welds the root link to the world and fuses fixed links; here the root link
gets a free joint, every link stays a body, and a target is one more body welded to the tool frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from hil.world.inertia import pi_of, report_of, symmetric
from hil.world.links import Body, Link, body_of, link_of, read_links, with_base
from hil.world.springs import Panel, SloshMass, Sprung
from hil.world.thrusters import ThrusterSystem
from hil.world.wheels import WheelSystem

FloatArray = NDArray[np.float64]

TARGET = "grasped target"  # name of the target's body in the model
BASE_NV = 6
BASE_NQ = 7


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
