"""The free-floating robot as the scoring sees it: everything linear in the unknown bodies.

The bench judges the flight software with its own model: Pinocchio for kinematics and regressors, no
flight code. Base axes B, base origin; nu = [v_b, w_b, qd]; zero gravity, zero momentum.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin

from hil.world.inertia import COUNT, FloatArray, frame_map
from hil.world.stand import Stand


class FloatingRobot:
    """Base, arm and target with the stacked parameters pi = known + select @ x.

    Parameters
    ----------
    urdf, tool_frame : the arms; root link = base, the target's frame is the tool frame
    bodies : pi (10,) of "base" and, when one is grasped, "target", in their own frames
    stand : holds the base in what sensors measure; None: it floats freely
    frames : what further bodies are fixed to, each in its own frame
    unknown : which of them x (10 each, in this order) stands for

    Attributes
    ----------
    n : joints
    known : (10 (n + 1),) stacked parameters with the unknown bodies' share zero
    select : (10 (n + 1), 10 len(unknown))
    """

    def __init__(
        self,
        urdf: Path,
        tool_frame: str,
        bodies: Mapping[str, FloatArray],
        unknown: Sequence[str],
        frames: Mapping[str, str] | None = None,
        stand: Stand | None = None,
    ) -> None:
        self.stand = stand
        self.model = pin.buildModelFromUrdf(str(urdf), pin.JointModelFreeFlyer())
        self.model.gravity.setZero()
        self.data = self.model.createData()
        self.n = self.model.nv - 6
        self._tool = self.model.getFrameId(tool_frame)
        links = [inertia.toDynamicParameters() for inertia in list(self.model.inertias)[1:]]
        links[0] = np.zeros(COUNT)
        self.known: FloatArray = np.concatenate(links)
        maps, spots = {"base": np.eye(COUNT)}, {"base": slice(0, COUNT)}
        for body, name in {"target": tool_frame, **(frames or {})}.items():
            frame = self.model.frames[self.model.getFrameId(name)]
            placement, held = frame.placement, int(frame.parentJoint) - 1
            maps[body] = frame_map(placement.rotation, placement.translation)
            spots[body] = slice(COUNT * held, COUNT * (held + 1))
        for body in bodies:
            if body not in unknown:
                self.known[spots[body]] += maps[body] @ bodies[body]
        self.select: FloatArray = np.zeros((self.known.size, COUNT * len(unknown)))
        for k, body in enumerate(unknown):
            self.select[spots[body], COUNT * k : COUNT * (k + 1)] = maps[body]
        self._q = pin.neutral(self.model)
        self._zero = np.zeros(self.model.nv)

    def stacked(self, x: FloatArray) -> FloatArray:
        """Return pi (10 (n + 1),) with the unknown bodies at x."""
        return np.asarray(self.known + self.select @ x)

    def regressor(self, q: FloatArray, nu: FloatArray, a: FloatArray) -> FloatArray:
        """Return Y (6 + n, 10 (n + 1)), generalised force = Y pi. A fresh array."""
        self._q[7:] = q
        return np.array(pin.computeJointTorqueRegressor(self.model, self.data, self._q, nu, a))

    def mass_columns(self, q: FloatArray) -> FloatArray:
        """Return (6 + n, 6, 10 (n + 1)): the first six columns of H as a linear map of pi."""
        units = np.eye(self.model.nv)[:6]
        return np.stack([self.regressor(q, self._zero, unit) for unit in units], 1)

    def momentum(self, q: FloatArray, qd: FloatArray) -> FloatArray:
        """Return (6, 10 (n + 1)): base momentum with the base held, H_bm qd, as a map of pi."""
        nu = np.concatenate((np.zeros(6), qd))
        return self.regressor(q, self._zero, nu)[:6]

    def bias_derivative(
        self, q: FloatArray, nu: FloatArray, a: FloatArray, pi: FloatArray
    ) -> FloatArray:
        """Return d(generalised force)/d nu (6 + n, 6 + n) at parameters pi, fixed acceleration."""
        for joint in range(1, self.model.njoints):
            own = pi[COUNT * (joint - 1) : COUNT * joint]
            self.model.inertias[joint] = pin.Inertia.FromDynamicParameters(own)
        self._q[7:] = q
        pin.computeRNEADerivatives(self.model, self.data, self._q, nu, a)
        return np.array(self.data.dtau_dv)

    def give(self, H_bb: FloatArray, force: FloatArray) -> FloatArray:
        """Return how a force on the base, (6,) or (6, k), moves it, held as it is."""
        if self.stand is None:
            return np.asarray(np.linalg.solve(H_bb, force))
        return self.stand.give(H_bb, force)

    @property
    def support(self) -> FloatArray:
        """(6,): acceleration of the base by which its stand holds it against gravity."""
        gravity = (0.0, 0.0, 0.0) if self.stand is None else self.stand.gravity_m_s2
        return np.concatenate((-np.array(gravity), np.zeros(3)))

    def tool_pose(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return R_BE (3, 3) and p_BE_B (3,) of the tool frame."""
        self._q[7:] = q
        pin.framesForwardKinematics(self.model, self.data, self._q)
        pose = self.data.oMf[self._tool]
        return np.array(pose.rotation), np.array(pose.translation)
