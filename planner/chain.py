"""The free-floating arms as CasADi expressions: all quantities at the base origin, in base axes.

Spatial vectors are [linear; angular] as in Pinocchio. Because all quantities refer to one point,
each joint is one axis S_i (6,), composite inertias are plain sums and the base needs no
transformation. The geometry is read from the Pinocchio model, the reference of the tests.

Source: Featherstone, Rigid Body Dynamics Algorithms (2008), chs. 5, 6 and 9.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pinocchio as pin

from fsw.estimators.model.inertia import PARAMETERS
from fsw.estimators.model.robot import RobotModel
from fsw.messages import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Geometry:
    """Geometry of the arms for the expressions: placements, axes and the tool."""

    parents: tuple[int, ...]  # body that carries joint i: 0 the base, k + 1 the link of joint k
    tool_body: int  # body that carries the tool frame
    R: tuple[FloatArray, ...]  # (3, 3) rotation of joint i at zero in its parent's frame
    p: tuple[FloatArray, ...]  # (3,) position of joint i in its parent's frame [m]
    axis: tuple[FloatArray, ...]  # (3,) axis of joint i in the joint's own frame
    slides: tuple[bool, ...]  # whether joint i is prismatic
    R_tool: FloatArray  # tool frame in the frame of `tool_body`
    p_tool: FloatArray
    pi_links: FloatArray  # (10 (n + 1),) parameters of base and links, without a target


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pose:
    """The arms at one joint position: frames and joint axes in B."""

    R: list[ca.SX]  # of the frames of base and joints, base first
    p: list[ca.SX]
    R_tool: ca.SX
    p_tool: ca.SX
    S: list[ca.SX]  # (6,) each
    parents: tuple[int, ...]

    def ancestors(self, body: int) -> list[int]:
        """Return the joints between the base and a body, the body's own joint first."""
        found = []
        while body > 0:
            found.append(body - 1)
            body = self.parents[body - 1]
        return found


def geometry(model: RobotModel, tool_frame: str) -> Geometry:
    """Read placements, axes and the tool frame from a robot model."""
    data = model.model.createData()
    pin.computeJointJacobians(model.model, data, pin.neutral(model.model))
    axes, slides = [], tuple(kind == "prismatic" for kind in model.kinds())
    for index in range(2, model.model.njoints):
        J = pin.getJointJacobian(model.model, data, index, pin.ReferenceFrame.LOCAL)
        axes.append(np.array(J[:3, 4 + index] if slides[index - 2] else J[3:, 4 + index]))
    placements = list(model.model.jointPlacements)[2:]
    tool = model.model.frames[model.frame_id(tool_frame, "robot.tool_frame")].placement
    return Geometry(
        parents=tuple(model.parents.tolist()),
        tool_body=model.tool.body,
        R=tuple(np.array(x.rotation) for x in placements),
        p=tuple(np.array(x.translation) for x in placements),
        axis=tuple(axes),
        slides=slides,
        R_tool=np.array(tool.rotation),
        p_tool=np.array(tool.translation),
        pi_links=model.pi_links,
    )


def pose(arm: Geometry, q: ca.SX) -> Pose:
    """Return all frames of the arms in the base frame at joint positions q (n,)."""
    R, p, S = [ca.SX.eye(3)], [ca.SX.zeros(3)], []
    for k, (axis, parent) in enumerate(zip(arm.axis, arm.parents, strict=True)):
        fixed = ca.sparsify(ca.SX(_clean(arm.R[k])))
        if arm.slides[k]:
            R.append(R[parent] @ fixed)
            direction = R[-1] @ axis
            p.append(p[parent] + R[parent] @ arm.p[k] + direction * q[k])
            S.append(ca.vertcat(direction, ca.SX(3, 1)))
            continue
        A = ca.skew(axis)
        turn = ca.SX.eye(3) + ca.sin(q[k]) * A + (1 - ca.cos(q[k])) * ca.mtimes(A, A)
        p.append(p[parent] + R[parent] @ arm.p[k])
        R.append(R[parent] @ (fixed @ turn))
        direction = R[-1] @ axis
        S.append(ca.vertcat(ca.cross(p[-1], direction), direction))
    at = arm.tool_body
    p_tool = p[at] + R[at] @ arm.p_tool
    R_tool = R[at] @ _clean(arm.R_tool)
    return Pose(R=R, p=p, R_tool=R_tool, p_tool=p_tool, S=S, parents=arm.parents)


def spatial_inertia(pi: ca.SX, R: ca.SX, p: ca.SX) -> ca.SX:
    """Return the 6 x 6 inertia about B's origin of a body with parameters pi (10,) in frame R, p.

    I_B = R I R^T - [p x][h x] - [h x][p x] - m [p x][p x] with h = R (m c). The first mass moment
    about B's origin is h + m p.
    """
    m, h = pi[0], R @ pi[1:4]
    own = ca.blockcat([[pi[4], pi[5], pi[7]], [pi[5], pi[6], pi[8]], [pi[7], pi[8], pi[9]]])
    P, Hx = ca.skew(p), ca.skew(h)
    moment = R @ own @ R.T - P @ Hx - Hx @ P - m * (P @ P)
    first = ca.skew(h + m * p)
    return ca.blockcat([[m * ca.SX.eye(3), -first], [first, moment]])


def motion_cross(V: ca.SX, S: ca.SX) -> ca.SX:
    """Return V x S of two motion vectors."""
    v, w = V[:3], V[3:]
    return ca.vertcat(ca.cross(v, S[3:]) + ca.cross(w, S[:3]), ca.cross(w, S[3:]))


def force_cross(V: ca.SX, F: ca.SX) -> ca.SX:
    """Return V x* F of a motion vector V and the force vectors in the columns of F."""
    v, w = ca.skew(V[:3]), ca.skew(V[3:])
    return ca.vertcat(w @ F[:3, :], v @ F[:3, :] + w @ F[3:, :])


def momentum_columns(V: ca.SX) -> ca.SX:
    """Return L (6, 10) with I V = L pi; V and the body's parameters pi are in the same frame."""
    v, w = V[:3], V[3:]
    x, y, z = w[0], w[1], w[2]
    zero = ca.SX(1, 1)
    rotary = ca.blockcat(
        [[x, y, zero, z, zero, zero], [zero, x, y, zero, z, zero], [zero, zero, zero, x, y, z]]
    )
    linear = ca.horzcat(v, ca.skew(w), ca.SX(3, 6))
    return ca.vertcat(linear, ca.horzcat(ca.SX(3, 1), -ca.skew(v), rotary))


def body_columns(V: ca.SX, A: ca.SX, R: ca.SX, p: ca.SX) -> ca.SX:
    """Return Y (6, 10): Y pi is the force at B's origin that moves a body in (R, p) with V, A."""
    Ve, Ae = _into(V, R, p), _into(A, R, p)
    return _back(momentum_columns(Ae) + force_cross(Ve, momentum_columns(Ve)), R, p)


def carried_momentum(V: ca.SX, R: ca.SX, p: ca.SX) -> ca.SX:
    """Return L (6, 10): L pi is the momentum about B's origin of a body in frame (R, p) with V."""
    return _back(momentum_columns(_into(V, R, p)), R, p)


def _into(V: ca.SX, R: ca.SX, p: ca.SX) -> ca.SX:
    """Return a motion vector, given at B's origin in B, at point p in the axes of R."""
    return ca.vertcat(R.T @ (V[:3] + ca.cross(V[3:], p)), R.T @ V[3:])


def _back(F: ca.SX, R: ca.SX, p: ca.SX) -> ca.SX:
    """Return force columns, given at point p in the axes of R, at B's origin in B."""
    force = R @ F[:3, :]
    return ca.vertcat(force, R @ F[3:, :] + ca.skew(p) @ force)


def velocities(arm: Pose, w: ca.SX, qd: ca.SX) -> tuple[list[ca.SX], list[ca.SX]]:
    """Return every body's velocity and velocity-product acceleration; the base moves by [0; w]."""
    V, A = [ca.vertcat(ca.SX(3, 1), w)], [ca.SX(6, 1)]
    for k, S in enumerate(arm.S):
        parent = arm.parents[k]
        V.append(V[parent] + S * qd[k])
        A.append(A[parent] + motion_cross(V[-1], S * qd[k]))
    return V, A


def all_parameters(arm: Geometry, base: ca.SX | None, target: ca.SX | None) -> list[ca.SX]:
    """Return the parameters (10,) of base, links and target; `base` replaces the URDF's base."""
    links = arm.pi_links.reshape(-1, PARAMETERS)
    bodies = [ca.SX(row) for row in links]
    if base is not None:
        bodies[0] = base
    if target is not None:
        bodies.append(target)
    return bodies


def _clean(R: FloatArray) -> FloatArray:
    """Set rounding errors of a constant rotation to zero, so that the expressions stay sparse."""
    return np.where(np.abs(R) < 1e-15, 0.0, R)
