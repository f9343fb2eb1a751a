"""Robots and motions for the tests of the truth, and Pinocchio's view of them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from hil.world.spline import JointSpline
from hil.world.truth import Body, Robot, TruthState, load_bodies

ROBOTS = Path(__file__).parents[2] / "hil" / "robots"
URDF = ROBOTS / "lbr3_satellite.urdf"
TWO_ARMS = ROBOTS / "two_arm_satellite.urdf"
BODIES = load_bodies(ROBOTS / "bodies.yaml")


@dataclass(frozen=True)
class Case:
    robot: Robot
    model: pin.Model
    spline: JointSpline


def random_spline(n: int, seed: int, start: np.ndarray | float = 0.0) -> JointSpline:
    points = np.zeros((12, n))
    points[4:-4] = np.random.default_rng(seed).normal(0.0, 0.3, (4, n))
    points[-4:] = points[-5]
    return JointSpline(20.0, points + start)


def pin_model(urdf: Path, target: Body | None, tool: str = "tool") -> pin.Model:
    # Pinocchio stores a continuous joint as cosine and sine; as a revolute one it has an angle.
    text = urdf.read_text(encoding="utf-8").replace('"continuous"', '"revolute"')
    model = pin.buildModelFromXML(text, pin.JointModelFreeFlyer())
    model.gravity.setZero()
    if target is not None:
        xx, xy, xz, yy, yz, zz = target.inertia_kg_m2
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        frame = model.frames[model.getFrameId(tool)]
        body = pin.Inertia(target.mass_kg, np.array(target.com_m), inertia)
        model.appendBodyToJoint(frame.parentJoint, body, frame.placement)
    return model


def stand_in(target: str | None) -> Case:
    body = None if target is None else BODIES[target]
    start = np.array([0.2, 0.8, 0.0, -0.8, 0.1, 0.5, 0.0])
    return Case(
        robot=Robot.load(URDF, "tool", target=body),
        model=pin_model(URDF, body),
        spline=random_spline(7, 3, start),
    )


def two_arms() -> Case:
    """Return the robot with two arms, the LEO target in its left one."""
    body = BODIES["target_leo"]
    start = np.array([0.2, 0.8, 0.0, -0.8, 0.1, 0.5, 0.0])
    return Case(
        robot=Robot.load(TWO_ARMS, "left_tool", target=body),
        model=pin_model(TWO_ARMS, body, "left_tool"),
        spline=random_spline(14, 5, np.concatenate([start, -start])),
    )


def random_arm(folder: Path) -> Case:
    """Three joints on tilted frames about odd axes, a fixed link between, rotated inertials."""
    path = folder / "random.urdf"
    path.write_text(random_urdf(np.random.default_rng(11)), encoding="utf-8")
    body = Body(35.0, (0.2, -0.1, 0.3), (4.0, 0.2, -0.1, 5.0, 0.3, 3.5))
    return Case(
        robot=Robot.load(path, "tool", target=body),
        model=pin_model(path, body),
        spline=random_spline(3, 4),
    )


def random_urdf(rng: np.random.Generator) -> str:
    def xyz(scale: float) -> str:
        return " ".join(f"{x:.6f}" for x in scale * rng.normal(size=3))

    def link(name: str, mass: float) -> str:
        a, b, c = mass * 0.1 * (1.0 + 0.2 * rng.random(3))
        return (
            f'<link name="{name}"><inertial><origin xyz="{xyz(0.2)}" rpy="{xyz(1.0)}"/>'
            f'<mass value="{mass}"/><inertia ixx="{a}" ixy="{0.05 * a}" ixz="0" iyy="{b}" '
            f'iyz="{0.04 * b}" izz="{c}"/></inertial></link>'
        )

    def joint(name: str, kind: str, parent: str, child: str) -> str:
        return (
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{xyz(0.3)}" rpy="{xyz(1.0)}"/><axis xyz="{xyz(1.0)}"/>'
            '<limit lower="-2" upper="2" effort="10" velocity="1"/></joint>'
        )

    parts = [
        link("bus", 120.0),
        joint("shoulder", "revolute", "bus", "upper"),
        link("upper", 9.0),
        joint("plate", "fixed", "upper", "bracket"),
        link("bracket", 2.0),
        joint("elbow", "continuous", "bracket", "fore"),
        link("fore", 6.0),
        joint("wrist", "revolute", "fore", "hand"),
        link("hand", 3.0),
        joint("grip", "fixed", "hand", "tool"),
        '<link name="tool"/>',
    ]
    # Written children first: the order of a URDF's elements means nothing.
    return f'<robot name="random">{"".join(reversed(parts))}</robot>'


def pin_state(state: TruthState, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Configuration, velocity and (spatial) acceleration in Pinocchio's conventions."""
    R, w = state.R_NB[k], state.w_NB_B[k]
    v = R.T @ state.v_NB_N[k]
    q = np.concatenate([state.p_NB_N[k], state.q_NB_xyzw[k], state.q[k]])
    linear = state.a_NB_B[k] - np.cross(w, v)
    return (
        q,
        np.concatenate([v, w, state.qd[k]]),
        np.concatenate([linear, state.wd_NB_B[k], state.qdd[k]]),
    )
