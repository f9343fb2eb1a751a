"""The free-floating robot model, a tree of joints: one typed wrapper over Pinocchio.

Joints are revolute or prismatic. For a prismatic joint, position, rate and torque are in m, m/s and
N wherever a name says rad, rad/s and N m.

The base is a free-flyer joint without gravity. The generalised velocity nu = [v_b, w_b, qd] and the
acceleration are spatial, in base axes. With v_b = 0, spatial and classical acceleration coincide.
Without gravity nothing depends on v_b (a constant velocity of the whole system changes no torque),
so all functions of (q, w, qd) here set v_b = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from fsw.estimators.model.inertia import (
    PARAMETERS,
    frame_change,
    frame_changes,
    parameter_basis,
    pseudo_inertia,
)
from fsw.estimators.model.urdf import UNLIMITED, dynamics_of
from fsw.messages import FloatArray
from fsw.messages.errors import ConfigError

REVOLUTE = ("JointModelRX", "JointModelRY", "JointModelRZ", "JointModelRevoluteUnaligned")
PRISMATIC = "JointModelP"
FRAMES = (pin.FrameType.BODY, pin.FrameType.FIXED_JOINT, pin.FrameType.JOINT)


@dataclass(frozen=True, slots=True, eq=False)
class Hold:
    """How a body hangs on the robot.

    Attributes
    ----------
    body : index of the robot's body that holds it: 0 the base, k + 1 the link of joint k
    places : the ten parameters of the holding body within pi (10 (n + 1),)
    map : (10, 10), from the held body's parameters in its own frame to the holding body's
    """

    body: int
    places: slice
    map: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Appended:
    """A revolute or prismatic joint on the base, or on the joint appended before it."""

    is_revolute: bool
    is_on_last: bool
    axis: FloatArray  # (3,) unit vector
    place_m: FloatArray  # (3,) of its frame's origin; the frame has the axes of the carrying body


class RobotModel:
    """Dynamics of base, known arm and grasped target, linear in the inertial parameters.

    Attributes
    ----------
    n : number of joints of all arms
    joint_names : names of the joints; a joint comes after the one that carries it
    pi_links : (10 (n + 1),) parameters of base and links as the URDF has them
    parents : (n,) body that carries each joint: 0 the base, k + 1 the link of joint k
    tool : how the target, in the tool frame E, hangs on the robot
    """

    def __init__(self, urdf: Path, tool_frame: str, text: str | None = None) -> None:
        """Read the URDF file, or `text` in its place; raise ConfigError if either is not usable."""
        try:
            dynamics = dynamics_of(urdf.read_bytes() if text is None else text)
            self.model = pin.buildModelFromXML(dynamics, pin.JointModelFreeFlyer())
        except (OSError, SyntaxError, ValueError, RuntimeError) as error:
            raise ConfigError(f"robot.urdf: {urdf} cannot be read as a URDF: {error}") from error
        self.model.gravity.setZero()
        self._lift_limits()
        self._name = urdf.name
        self.n = self.model.nv - 6
        self.joint_names = tuple(self.model.names[2:])
        for index in range(2, self.model.njoints):
            kind = self.model.joints[index].shortname()
            if not kind.startswith((*REVOLUTE, PRISMATIC)):
                raise ConfigError(
                    f"robot.urdf: joint {self.model.names[index]!r} is of a kind not supported; "
                    "every joint must be continuous, revolute, prismatic or fixed"
                )
        self._tool = self.frame_id(tool_frame, "robot.tool_frame")
        self.parents = np.array(self.model.parents[2:], np.intp) - 1
        self.tool = self.hold(tool_frame, "robot.tool_frame")
        if self.tool.body in {0, *self.parents.tolist()} and self.n:
            raise ConfigError(
                f"robot.tool_frame: {tool_frame!r} is not fixed to the last link of an arm"
            )
        self.set_up()

    def set_up(self) -> None:
        """Set everything that follows from the joints of `model`."""
        self.data = self.model.createData()
        self.pi_links = np.concatenate(
            [inertia.toDynamicParameters() for inertia in list(self.model.inertias)[1:]]
        )
        self._q = pin.neutral(self.model)
        self._v = np.zeros(self.model.nv)
        self._zero = np.zeros(self.model.nv)
        self._lower = np.tril_indices(self.model.nv, -1)
        self._set = np.full(self.pi_links.size, np.nan)
        self._carries = self._support()

    def with_joints(self, joints: Sequence[Appended]) -> RobotModel:
        """Return a robot with more joints behind its own; their bodies have no mass yet."""
        other = copy(self)
        other.model, last = self.model.copy(), 1
        for joint in joints:
            revolute, sliding = pin.JointModelRevoluteUnaligned, pin.JointModelPrismaticUnaligned
            own = (revolute if joint.is_revolute else sliding)(joint.axis)
            place, name = pin.SE3(np.eye(3), joint.place_m), f"appended {other.model.njoints}"
            last = other.model.addJoint(last if joint.is_on_last else 1, own, place, name)
        other.n = other.model.nv - 6
        other.joint_names = tuple(other.model.names[2:])
        other.parents = np.array(other.model.parents[2:], np.intp) - 1
        other.set_up()
        return other

    def hold(self, frame_name: str, key: str) -> Hold:
        """Return how a body that is fixed to a frame of the robot hangs on it.

        Raises
        ------
        ConfigError naming `key` if there is no such frame.
        """
        frame = self.model.frames[self.frame_id(frame_name, key)]
        body = int(frame.parentJoint) - 1
        places = slice(PARAMETERS * body, PARAMETERS * (body + 1))
        placement = frame.placement
        return Hold(body, places, frame_change(placement.rotation, placement.translation))

    def frame_id(self, name: str, key: str) -> int:
        """Return the library's number of a link's frame, or else of the frame of a joint.

        A link and a joint may have one name.

        Raises
        ------
        ConfigError naming `key` if there is no such frame.
        """
        for kind in FRAMES:
            if self.model.existFrame(name, kind):
                found: int = self.model.getFrameId(name, kind)
                return found
        names = [f.name for f in self.model.frames if f.type == pin.FrameType.BODY]
        raise ConfigError(f"{key}: {name!r} is no frame of {self._name}; it has {names}")

    def _lift_limits(self) -> None:
        """Replace the limits that mean none by infinity."""
        own = self.model
        for limits in (own.lowerPositionLimit, own.upperPositionLimit):
            limits[7:][np.abs(limits[7:]) >= UNLIMITED] *= np.inf
        for limits in (own.velocityLimit, own.effortLimit):
            limits[6:][limits[6:] >= UNLIMITED] = np.inf

    def _support(self) -> NDArray[np.bool_]:
        """Return (n + 1, n): whether a joint (column) carries a body (row)."""
        carries = np.zeros((self.n + 1, self.n), np.bool_)
        for joint, parent in enumerate(self.parents):
            carries[joint + 1] = carries[parent]
            carries[joint + 1, joint] = True
        return carries

    def kinds(self) -> tuple[str, ...]:
        """Return for every joint "revolute" or "prismatic"."""
        names = [self.model.joints[index].shortname() for index in range(2, self.model.njoints)]
        return tuple("prismatic" if name.startswith(PRISMATIC) else "revolute" for name in names)

    def steps_m(self) -> list[float]:
        """Return the distance of every joint from the joint, or base, that carries it [m]."""
        return [float(np.linalg.norm(X.translation)) for X in list(self.model.jointPlacements)[2:]]

    def total_parameters(self, base: FloatArray, target: FloatArray | None) -> FloatArray:
        """Return pi (10 (n + 1),) with `base` (in B), and `target` (in E) added to its link."""
        pi = self.pi_links.copy()
        pi[:PARAMETERS] = base
        if target is not None:
            pi[self.tool.places] += self.tool.map @ target
        return pi

    def set_parameters(self, pi: FloatArray) -> None:
        """Set the inertias to `pi` (10 (n + 1),), for all functions except the regressors."""
        if np.array_equal(pi, self._set):
            return
        for index in range(1, self.model.njoints):
            own = pi[PARAMETERS * (index - 1) : PARAMETERS * index]
            self.model.inertias[index] = _spatial_inertia(own)
        self._set = pi.copy()

    def _move(self, q: FloatArray, w: FloatArray, qd: FloatArray) -> None:
        self._q[7:] = q
        self._v[:3] = 0.0
        self._v[3:6] = w
        self._v[6:] = qd

    def regressor(self, q: FloatArray, w: FloatArray, qd: FloatArray, a: FloatArray) -> FloatArray:
        """Return Y (6+n, 10 (n+1)): generalised force = Y pi; rows base force, moment, joints.

        Parameters: q, qd (n,), w = w_NB_B (3,), a (6+n,). The first three of `a` are the classical
        acceleration of the base's origin in base axes. Source: eqs. (3)-(7) of the paper, as
        Pinocchio evaluates them.
        """
        self._move(q, w, qd)
        Y: FloatArray = pin.computeJointTorqueRegressor(self.model, self.data, self._q, self._v, a)
        return Y

    def generalised_force(
        self, q: FloatArray, w: FloatArray, qd: FloatArray, a: FloatArray
    ) -> FloatArray:
        """Return Y pi (6+n,) with Y of `regressor` and pi of `set_parameters`."""
        self._move(q, w, qd)
        force: FloatArray = pin.rnea(self.model, self.data, self._q, self._v, a)
        return force

    def momentum_regressor(self, q: FloatArray, nu: FloatArray) -> FloatArray:
        """Return Y(q, 0, nu) (6+n, 10 (n+1)) with H nu = Y pi; base rows: the momentum."""
        self._q[7:] = q
        Y: FloatArray = pin.computeJointTorqueRegressor(
            self.model, self.data, self._q, self._zero, nu
        )
        return Y

    def mass_matrix(self, q: FloatArray) -> FloatArray:
        """Return H(q) (6+n, 6+n), full and symmetric, with pi of `set_parameters`."""
        self._q[7:] = q
        H: FloatArray = pin.crba(self.model, self.data, self._q).copy()
        H[self._lower] = H.T[self._lower]  # crba fills the upper triangle
        return H

    def bias_derivative(
        self, q: FloatArray, w: FloatArray, qd: FloatArray, a: FloatArray
    ) -> FloatArray:
        """Return d(generalised force)/d nu at fixed acceleration, (6+n, 6+n)."""
        self._move(q, w, qd)
        pin.computeRNEADerivatives(self.model, self.data, self._q, self._v, a)
        derivative: FloatArray = self.data.dtau_dv
        return derivative

    def angle_derivative(
        self, q: FloatArray, w: FloatArray, qd: FloatArray, a: FloatArray
    ) -> FloatArray:
        """Return d(generalised force)/dq (6+n, n) at fixed velocity and acceleration."""
        self.bias_derivative(q, w, qd, a)
        derivative: FloatArray = self.data.dtau_dq[:, 6:]
        return derivative

    def momentum_derivative(self, q: FloatArray, nu: FloatArray) -> FloatArray:
        """Return d(base momentum)/dq (6, n) at fixed velocity nu (6+n,)."""
        self._q[7:] = q
        pin.computeRNEADerivatives(self.model, self.data, self._q, self._zero, nu)
        derivative: FloatArray = self.data.dtau_dq[:6, 6:]
        return derivative

    def regressors(self, q: FloatArray, w: FloatArray, qd: FloatArray, a: FloatArray) -> FloatArray:
        """Return `regressor` at N states, (N, 6+n, 10 (n+1)); arguments have N rows."""
        Q, V = self._states(q, w, qd)
        out = np.empty((len(q), self.model.nv, self.pi_links.size))
        model, data, evaluate = self.model, self.data, pin.computeJointTorqueRegressor
        for i in range(len(q)):
            out[i] = evaluate(model, data, Q[i], V[i], a[i])
        return out

    def momentum_regressors(self, q: FloatArray, nu: FloatArray) -> FloatArray:
        """Return `momentum_regressor` at N states, (N, 6+n, 10 (n+1))."""
        Q = self._angles(q)
        out = np.empty((len(q), self.model.nv, self.pi_links.size))
        model, data, evaluate = self.model, self.data, pin.computeJointTorqueRegressor
        for i in range(len(q)):
            out[i] = evaluate(model, data, Q[i], self._zero, nu[i])
        return out

    def mass_matrices(self, q: FloatArray) -> FloatArray:
        """Return `mass_matrix` at N states, (N, 6+n, 6+n)."""
        Q = self._angles(q)
        out = np.empty((len(q), self.model.nv, self.model.nv))
        model, data, evaluate = self.model, self.data, pin.crba
        for i in range(len(q)):
            out[i] = evaluate(model, data, Q[i])
        rows, columns = self._lower
        out[:, rows, columns] = out[:, columns, rows]  # crba fills the upper triangle
        return out

    def bias_derivatives(
        self, q: FloatArray, w: FloatArray, qd: FloatArray, a: FloatArray
    ) -> FloatArray:
        """Return `bias_derivative` at N states, (N, 6+n, 6+n)."""
        return self.forces_and_derivatives(q, w, qd, a)[0]

    def forces_and_derivatives(
        self, q: FloatArray, w: FloatArray, qd: FloatArray, a: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return `bias_derivative` and `generalised_force` at N states, in one recursion each."""
        Q, V = self._states(q, w, qd)
        out, forces = np.empty((len(q), self.model.nv, self.model.nv)), np.empty(V.shape)
        model, data, evaluate = self.model, self.data, pin.computeRNEADerivatives
        for i in range(len(q)):
            evaluate(model, data, Q[i], V[i], a[i])
            out[i], forces[i] = data.dtau_dv, data.tau
        return out, forces

    def _angles(self, q: FloatArray) -> FloatArray:
        Q = np.empty((len(q), self._q.size))
        Q[:, :7], Q[:, 7:] = self._q[:7], q
        return Q

    def _states(
        self, q: FloatArray, w: FloatArray, qd: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        V = np.zeros((len(q), self.model.nv))
        V[:, 3:6], V[:, 6:] = w, qd
        return self._angles(q), V

    def composite(self, q: FloatArray) -> FloatArray:
        """Return C (10, 10 (n+1)): parameters of the whole robot in B = C @ pi."""
        whole: FloatArray = self.composites(q[None])[0]
        return whole

    def composites(self, q: FloatArray) -> FloatArray:
        """Return `composite` at N states (N, n), (N, 10, 10 (n+1))."""
        maps = self._maps_to_base(q)
        return maps.transpose(0, 2, 1, 3).reshape(len(q), PARAMETERS, -1)

    def point_jacobian(self, q: FloatArray, p_E_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return J (6, 6+n) and R_BE: J nu is the velocity of a point of E and E's rate, in B."""
        self._q[7:] = q
        J: FloatArray = pin.computeFrameJacobian(
            self.model, self.data, self._q, self._tool, pin.LOCAL_WORLD_ALIGNED
        )
        R_BE: FloatArray = self.data.oMf[self._tool].rotation.copy()
        J[:3] -= pin.skew(R_BE @ p_E_m) @ J[3:]
        return J, R_BE

    def field_regressors(self, q: FloatArray, G: FloatArray) -> FloatArray:
        """Return Y (N, 6+n, 10 (n+1)): at N states the field G (N, 3, 3) makes forces Y pi.

        Every mass element at s from the base's origin feels the acceleration G s, in base axes. The
        uniform part by which this differs from the field about the centre of mass moves no joint.
        """
        maps, Q = self._maps_to_base(q), self._angles(q)
        wrenches = _field_wrenches(G)[:, None] @ maps  # (N, n+1, 6, 10), about the base's origin
        J = np.empty((len(q), 6, self.n))
        for i in range(len(q)):
            J[i] = pin.computeJointJacobians(self.model, self.data, Q[i])[:, 6:]
        rows = np.empty((len(q), self.n + 1, 6 + self.n, PARAMETERS))
        rows[:, :, :6] = wrenches
        rows[:, :, 6:] = J.transpose(0, 2, 1)[:, None] @ wrenches
        rows[:, :, 6:][:, ~self._carries] = 0.0  # a joint moves only the bodies beyond it
        return rows.transpose(0, 2, 1, 3).reshape(len(q), 6 + self.n, -1)

    def _maps_to_base(self, q: FloatArray) -> FloatArray:
        """Return (N, n+1, 10, 10): maps of parameters from the frames of base and links to B."""
        Q, bodies = self._angles(q), self.n + 1
        X = np.empty((len(q), bodies, 4, 4))
        for i in range(len(q)):
            pin.forwardKinematics(self.model, self.data, Q[i])
            for k, placement in enumerate(list(self.data.oMi)[1:]):
                X[i, k] = placement.homogeneous
        return frame_changes(X.reshape(-1, 4, 4)).reshape(len(q), bodies, PARAMETERS, PARAMETERS)


def _spatial_inertia(pi: FloatArray) -> pin.Inertia:
    if pi[0] == 0.0:  # a massless link of the URDF
        P = pseudo_inertia(pi)
        return pin.Inertia(0.0, np.zeros(3), np.trace(P[:3, :3]) * np.eye(3) - P[:3, :3])
    return pin.Inertia.FromDynamicParameters(pi)


@lru_cache(maxsize=1)
def _field_wrench_by_field() -> FloatArray:
    """Return (60, 9): force and moment about the origin, by parameter, of each element of G."""
    W = np.zeros((9, 6, PARAMETERS))
    for k, G in enumerate(np.eye(9).reshape(9, 3, 3)):
        W[k, :3, 1:4] = G
        M = G @ parameter_basis()[:, :3, :3]
        W[k, 3], W[k, 4], W[k, 5] = (M[:, j, i] - M[:, i, j] for i, j in ((1, 2), (2, 0), (0, 1)))
    return W.reshape(9, -1).T


def _field_wrenches(G: FloatArray) -> FloatArray:
    """Return W (N, 6, 10): W pi is force and moment about the origin of the field G s on a body."""
    W: FloatArray = G.reshape(-1, 9) @ _field_wrench_by_field().T
    return W.reshape(-1, 6, PARAMETERS)
