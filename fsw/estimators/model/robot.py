"""The free-floating robot model, a tree of joints: one typed wrapper over Pinocchio.

Joints are revolute or prismatic. For a prismatic joint, position, rate and torque are in m, m/s and
N wherever a name says rad, rad/s and N m.

The base is a free-flyer joint without gravity. The generalised velocity nu = [v_b, w_b, qd] and the
acceleration are spatial, in base axes. With v_b = 0, spatial and classical acceleration coincide.
Without gravity nothing depends on v_b (a constant velocity of the whole system changes no torque),
so all functions of (q, w, qd) here set v_b = 0.

A generalised force has R = 6 + n + 6 s rows: base, joints, and the axes of s wrench sensors. Every
sensor makes a body of its own of what it carries, so that there are K = 1 + n + s bodies.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from fsw.errors import ConfigError
from fsw.estimators.model.field import field_wrenches
from fsw.estimators.model.inertia import PARAMETERS, about_origin, frame_change, frame_changes
from fsw.estimators.model.urdf import UNLIMITED, dynamics_of
from fsw.estimators.model.wrench_sensor import WrenchSensor, with_sensors
from fsw.messages import FloatArray, IntArray

REVOLUTE = ("JointModelRX", "JointModelRY", "JointModelRZ", "JointModelRevoluteUnaligned")
PRISMATIC = "JointModelP"
ROOT = "<base>"  # name of the base's joint in the library; the URDF may have a root_joint
FRAMES = (pin.FrameType.BODY, pin.FrameType.FIXED_JOINT, pin.FrameType.JOINT)


@dataclass(frozen=True, slots=True, eq=False)
class Hold:
    """How a body hangs on the robot.

    Attributes
    ----------
    body : index of the robot's body that holds it, as in `RobotModel.body_names`
    places : the ten parameters of the holding body within pi (10 K,)
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
    plain : the same robot without wrench sensors
    torque_units : unit of the torque of each joint, then of the t - n axes of wrench sensors
    torque_sensors : sensor of each: the joint's own, or the one that has the axis
    body_names : "base", then names of joints and sensors in the order of their bodies
    pi_links : (10 K,) parameters of the bodies as the URDF has them
    parents : (n,) body that carries each joint; without sensors 0 the base, k + 1 that of joint k
    tool : how the target, in the tool frame E, hangs on the robot
    """

    def __init__(
        self,
        urdf: Path,
        tool_frame: str,
        text: str | None = None,
        sensors: Sequence[WrenchSensor] = (),
    ) -> None:
        """Read the URDF file, or `text` in its place; raise ConfigError if either is not usable."""
        self._sensors = tuple(sensors)
        self.plain: RobotModel = RobotModel(urdf, tool_frame, text) if sensors else self
        try:
            dynamics = dynamics_of(urdf.read_bytes() if text is None else text)
            dynamics = with_sensors(dynamics, self._sensors)
            self.model = pin.buildModelFromXML(dynamics, pin.JointModelFreeFlyer(), ROOT)
        except (OSError, SyntaxError, ValueError, RuntimeError) as error:
            raise ConfigError(f"robot.urdf: {urdf} cannot be read as a URDF: {error}") from error
        self.model.gravity.setZero()
        self._lift_limits()
        self._name = urdf.name
        for index in range(2, self.model.njoints):
            kind = self.model.joints[index].shortname()
            if not kind.startswith((*REVOLUTE, PRISMATIC)):
                raise ConfigError(
                    f"robot.urdf: joint {self.model.names[index]!r} is of a kind not supported; "
                    "every joint must be continuous, revolute, prismatic or fixed"
                )
        self._tool = self.frame_id(tool_frame, "robot.tool_frame")
        self.set_up()
        self.tool = self.hold(tool_frame, "robot.tool_frame")
        after = [k for k in range(self.n) if self.parents[k] == self.tool.body]
        if self.n and (after or not self.tool.body):
            names = ", ".join(repr(self.joint_names[k]) for k in after) or "no joint"
            raise ConfigError(
                f"robot.tool_frame: {tool_frame!r} is not fixed to the last link of an arm: it "
                f"moves with {self.body_names[self.tool.body]!r}, and {names} comes after; choose "
                "a link behind, or write joints that are held still, as of fingers, as fixed"
            )

    def set_up(self) -> None:
        """Set everything that follows from the joints of `model`."""
        self.data = self.model.createData()
        names, fixed = list(self.model.names), [axis for own in self._sensors for axis in own.axes]
        self._joints = [k for k in range(2, len(names)) if names[k] not in fixed]
        self.n = len(self._joints)
        self.joint_names = tuple(names[k] for k in self._joints)
        units = ["N" if kind == "prismatic" else "N m" for kind in self.kinds()]
        self.torque_units = dict(zip(self.joint_names, units, strict=True))
        for own in self._sensors:
            self.torque_units |= own.units
        self.torque_sensors = (*self.joint_names, *(axis.partition(".")[0] for axis in fixed))
        carried = {names.index(own.axes[-1]): own.name for own in self._sensors}
        bodies = {1: "base", **{k: names[k] for k in self._joints}, **carried}
        self._bodies = sorted(bodies)  # the library's numbers
        self.body_names = tuple(bodies[k] for k in self._bodies)
        places = np.array([*self._joints, *(names.index(axis) for axis in fixed)], np.intp) + 4
        self._rows = np.concatenate([np.arange(6), places])  # the library's places, of one each
        self._moves = self._rows[: 6 + self.n]
        first = PARAMETERS * (np.array(self._bodies) - 1)
        self._columns = (first[:, None] + np.arange(PARAMETERS)).ravel()
        carriers = [int(self.model.parents[k]) for k in self._joints]
        self.parents = np.array([self._bodies.index(k) for k in carriers], np.intp)
        links = self.model.inertias
        self.pi_links = np.concatenate([links[k].toDynamicParameters() for k in self._bodies])
        self._q = pin.neutral(self.model)
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
        other.set_up()
        return other

    def hold(self, frame_name: str, key: str) -> Hold:
        """Return how a body that is fixed to a frame of the robot hangs on it.

        Raises
        ------
        ConfigError naming `key` if there is no such frame.
        """
        frame = self.model.frames[self.frame_id(frame_name, key)]
        body = self._bodies.index(int(frame.parentJoint))
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
        links = [f.name for f in self.model.frames if f.type == pin.FrameType.BODY]
        own = tuple(f"{sensor.name}." for sensor in self._sensors)
        names = [link for link in links if not link.startswith(own)]
        raise ConfigError(f"{key}: {name!r} is not a frame of {self._name}; it has {names}")

    def _lift_limits(self) -> None:
        """Replace the limits that mean none by infinity."""
        own = self.model
        for limits in (own.lowerPositionLimit, own.upperPositionLimit):
            limits[7:][np.abs(limits[7:]) >= UNLIMITED] *= np.inf
        for limits in (own.velocityLimit, own.effortLimit):
            limits[6:][limits[6:] >= UNLIMITED] = np.inf

    def _support(self) -> NDArray[np.bool_]:
        """Return (K, R - 6): whether a joint or an axis (column) carries a body (row)."""
        paths = [set(self.model.supports[k]) for k in self._bodies]
        carries = [[int(row) - 4 in path for row in self._rows[6:]] for path in paths]
        return np.array(carries, np.bool_).reshape(len(paths), -1)

    def kinds(self) -> tuple[str, ...]:
        """Return for every joint "revolute" or "prismatic"."""
        names = [self.model.joints[index].shortname() for index in self._joints]
        return tuple("prismatic" if name.startswith(PRISMATIC) else "revolute" for name in names)

    def steps_m(self) -> list[float]:
        """Return the distance of every joint from the joint, or base, that carries it [m]."""
        places = self.model.jointPlacements
        return [float(np.linalg.norm(places[k].translation)) for k in self._joints]

    def total_parameters(self, base: FloatArray, target: FloatArray | None) -> FloatArray:
        """Return pi (10 K,) with `base` (in B), and `target` (in E) added to its link."""
        pi = self.pi_links.copy()
        pi[:PARAMETERS] = base
        if target is not None:
            pi[self.tool.places] += self.tool.map @ target
        return pi

    def set_parameters(self, pi: FloatArray) -> None:
        """Set the inertias to `pi` (10 K,), for all functions except the regressors."""
        if np.array_equal(pi, self._set):
            return
        for index, own in zip(self._bodies, pi.reshape(-1, PARAMETERS), strict=True):
            # the library divides by the mass, which a link of the URDF may lack
            found = pin.Inertia.FromDynamicParameters(own) if own[0] else None
            self.model.inertias[index] = found or pin.Inertia(0.0, np.zeros(3), about_origin(own))
        self._set = pi.copy()

    def regressor(self, q: FloatArray, w: FloatArray, qd: FloatArray, a: FloatArray) -> FloatArray:
        """Return Y (R, 10 K): generalised force = Y pi; rows base force, moment, joints, axes.

        Parameters: q, qd (n,), w = w_NB_B (3,), a (6+n,). The first three of `a` are the classical
        acceleration of the base's origin in base axes. Source: eqs. (3)-(7) of the paper, as
        Pinocchio evaluates them.
        """
        Y: FloatArray = self.regressors(q[None], w[None], qd[None], a[None])[0]
        return Y

    def momentum_regressor(self, q: FloatArray, nu: FloatArray) -> FloatArray:
        """Return Y(q, 0, nu) (R, 10 K) with H nu = Y pi; base rows: the momentum."""
        Y: FloatArray = self.momentum_regressors(q[None], nu[None])[0]
        return Y

    def mass_matrix(self, q: FloatArray) -> FloatArray:
        """Return H(q) (R, 6+n) with pi of `set_parameters`; full, symmetric without sensors."""
        H: FloatArray = self.mass_matrices(q[None])[0]
        return H

    def angle_derivatives(
        self, q: FloatArray, w: FloatArray, qd: FloatArray, a: FloatArray
    ) -> FloatArray:
        """Return d(generalised force)/dq (N, R, n) at N states of fixed velocity, acceleration."""
        Q, V = self._states(q, w, qd)
        return self._by_angle(Q, V, self._motions(a), self._rows)

    def momentum_derivatives(self, q: FloatArray, nu: FloatArray) -> FloatArray:
        """Return d(base momentum)/dq (N, 6, n) at N states of fixed velocity nu (N, 6+n)."""
        still = np.broadcast_to(self._zero, (len(q), self._zero.size))
        return self._by_angle(self._angles(q), still, self._motions(nu), np.arange(6))

    def _by_angle(self, Q: FloatArray, V: FloatArray, A: FloatArray, rows: IntArray) -> FloatArray:
        own = rows[:, None], self._moves[6:]
        out = np.empty((len(Q), len(rows), len(self._moves) - 6))
        model, data, evaluate = self.model, self.data, pin.computeRNEADerivatives
        for i in range(len(Q)):
            evaluate(model, data, Q[i], V[i], A[i])
            out[i] = data.dtau_dq[own]
        return out

    def regressors(self, q: FloatArray, w: FloatArray, qd: FloatArray, a: FloatArray) -> FloatArray:
        """Return `regressor` at N states, (N, R, 10 K); arguments have N rows."""
        Q, V = self._states(q, w, qd)
        return self._all_regressors(Q, V, self._motions(a))

    def momentum_regressors(self, q: FloatArray, nu: FloatArray) -> FloatArray:
        """Return `momentum_regressor` at N states, (N, R, 10 K)."""
        still = np.broadcast_to(self._zero, (len(q), self._zero.size))
        return self._all_regressors(self._angles(q), still, self._motions(nu))

    def _all_regressors(self, Q: FloatArray, V: FloatArray, A: FloatArray) -> FloatArray:
        out = np.empty((len(Q), self.model.nv, PARAMETERS * (self.model.njoints - 1)))
        model, data, evaluate = self.model, self.data, pin.computeJointTorqueRegressor
        for i in range(len(Q)):
            out[i] = evaluate(model, data, Q[i], V[i], A[i])
        return out[:, self._rows[:, None], self._columns] if self._sensors else out

    def mass_matrices(self, q: FloatArray) -> FloatArray:
        """Return `mass_matrix` at N states, (N, R, 6+n)."""
        Q = self._angles(q)
        out = np.empty((len(q), self.model.nv, self.model.nv))
        model, data, evaluate = self.model, self.data, pin.crba
        for i in range(len(q)):
            out[i] = evaluate(model, data, Q[i])
        rows, columns = self._lower
        out[:, rows, columns] = out[:, columns, rows]  # crba fills the upper triangle
        return self._by_motion(out)

    def forces_and_derivatives(
        self, q: FloatArray, w: FloatArray, qd: FloatArray, a: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return d(Y pi)/d nu at fixed acceleration (N, R, 6+n), and Y pi (N, R), at N states.

        Y is that of `regressor`, pi that of `set_parameters`; one recursion for each state.
        """
        Q, V = self._states(q, w, qd)
        A, out, forces = self._motions(a), np.empty((len(q), *self.data.dtau_dv.shape)), V.copy()
        model, data, evaluate = self.model, self.data, pin.computeRNEADerivatives
        for i in range(len(q)):
            evaluate(model, data, Q[i], V[i], A[i])
            out[i], forces[i] = data.dtau_dv, data.tau
        return self._by_motion(out), forces[:, self._rows] if self._sensors else forces

    def _by_motion(self, whole: FloatArray) -> FloatArray:
        """Return the rows of forces and the columns of motions (N, R, 6+n)."""
        return whole[:, self._rows[:, None], self._moves] if self._sensors else whole

    def _motions(self, nu: FloatArray) -> FloatArray:
        """Return velocities or accelerations (N, 6+n) as the library has them."""
        if not self._sensors:
            return nu
        V = np.zeros((len(nu), self.model.nv))
        V[:, self._moves] = nu
        return V

    def _angles(self, q: FloatArray) -> FloatArray:
        Q = np.tile(self._q, (len(q), 1))
        Q[:, 1 + self._moves[6:]] = q
        return Q

    def _states(
        self, q: FloatArray, w: FloatArray, qd: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        V = np.zeros((len(q), self.model.nv))
        V[:, 3:6], V[:, self._moves[6:]] = w, qd
        return self._angles(q), V

    def composite(self, q: FloatArray) -> FloatArray:
        """Return C (10, 10 K): parameters of the whole robot in B = C @ pi."""
        whole: FloatArray = self.composites(q[None])[0]
        return whole

    def composites(self, q: FloatArray) -> FloatArray:
        """Return `composite` at N states (N, n), (N, 10, 10 K)."""
        maps = self._maps_to_base(q)
        return maps.transpose(0, 2, 1, 3).reshape(len(q), PARAMETERS, -1)

    def point_jacobian(self, q: FloatArray, p_E_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return J (6, R) and R_BE: J nu is the velocity of a point of E and E's rate, in B."""
        J: FloatArray = pin.computeFrameJacobian(
            self.model, self.data, self._angles(q[None])[0], self._tool, pin.LOCAL_WORLD_ALIGNED
        )[:, self._rows]
        R_BE: FloatArray = self.data.oMf[self._tool].rotation.copy()
        J[:3] -= pin.skew(R_BE @ p_E_m) @ J[3:]
        return J, R_BE

    def field_regressors(self, q: FloatArray, G: FloatArray) -> FloatArray:
        """Return Y (N, R, 10 K): at N states the field G (N, 3, 3) makes forces Y pi.

        Every mass element at s from the base's origin feels the acceleration G s, in base axes. The
        uniform part by which this differs from the field about the centre of mass moves no joint.
        """
        maps, Q = self._maps_to_base(q), self._angles(q)
        wrenches = field_wrenches(G)[:, None] @ maps  # (N, K, 6, 10), about the base's origin
        J = np.empty((len(q), 6, len(self._rows) - 6))
        for i in range(len(q)):
            J[i] = pin.computeJointJacobians(self.model, self.data, Q[i])[:, self._rows[6:]]
        rows = np.empty((len(q), len(self._bodies), len(self._rows), PARAMETERS))
        rows[:, :, :6] = wrenches
        rows[:, :, 6:] = J.transpose(0, 2, 1)[:, None] @ wrenches
        rows[:, :, 6:][:, ~self._carries] = 0.0  # a joint moves only the bodies beyond it
        return rows.transpose(0, 2, 1, 3).reshape(len(q), len(self._rows), -1)

    def _maps_to_base(self, q: FloatArray) -> FloatArray:
        """Return (N, K, 10, 10): maps of parameters from the frames of base and links to B."""
        Q, bodies = self._angles(q), len(self._bodies)
        X = np.empty((len(q), bodies, 4, 4))
        for i in range(len(q)):
            pin.forwardKinematics(self.model, self.data, Q[i])
            for k, body in enumerate(self._bodies):
                X[i, k] = self.data.oMi[body].homogeneous
        return frame_changes(X.reshape(-1, 4, 4)).reshape(len(q), bodies, PARAMETERS, PARAMETERS)
