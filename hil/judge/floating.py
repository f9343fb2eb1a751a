"""Free-floating robot model of the scoring, linear in the unknown bodies' parameters.

The bench judges the flight software with a separate model: Pinocchio for kinematics and regressors,
no flight code. Base axes B, base origin; nu = [v_b, w_b, qd]; zero gravity, zero momentum.
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
    bodies : pi (10,) of "base", of "target" if one is grasped, and others, in body frames
    stand : laboratory stand that holds the base; None: the base floats freely
    frames : frame to which each further body is fixed
    unknown : bodies whose parameters x holds (10 each, in this order)

    Attributes
    ----------
    n : number of joints
    known : (10 (n + 1),) stacked parameters with the unknown bodies' share zero
    select : (10 (n + 1), 10 len(unknown)) map from x to stacked parameters
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
        first = np.array([joint.idx_q for joint in list(self.model.joints)[2:]], np.intp)
        self._turns = np.array([joint.nq == 2 for joint in list(self.model.joints)[2:]], bool)
        self._straight, self._cosine = first[~self._turns], first[self._turns]
        self._zero = np.zeros(self.model.nv)

    def _pose(self, q: FloatArray) -> None:
        """Set the library's coordinates: cosine and sine of a continuous joint, else the angle."""
        self._q[self._straight] = q[~self._turns]
        self._q[self._cosine], self._q[self._cosine + 1] = (
            np.cos(q[self._turns]),
            np.sin(q[self._turns]),
        )

    def stacked(self, x: FloatArray) -> FloatArray:
        """Return pi (10 (n + 1),) with the parameters x of the unknown bodies."""
        return np.asarray(self.known + self.select @ x)

    def regressor(self, q: FloatArray, nu: FloatArray, a: FloatArray) -> FloatArray:
        """Return Y (6 + n, 10 (n + 1)) as a new array: generalised force = Y pi."""
        self._pose(q)
        return np.array(pin.computeJointTorqueRegressor(self.model, self.data, self._q, nu, a))

    def mass_columns(self, q: FloatArray) -> FloatArray:
        """Return the map (6 + n, 6, 10 (n + 1)) from pi to the first six columns of H."""
        units = np.eye(self.model.nv)[:6]
        return np.stack([self.regressor(q, self._zero, unit) for unit in units], 1)

    def momentum(self, q: FloatArray, qd: FloatArray) -> FloatArray:
        """Return the map (6, 10 (n + 1)) from pi to the base momentum H_bm qd of a held base."""
        nu = np.concatenate((np.zeros(6), qd))
        return self.regressor(q, self._zero, nu)[:6]

    def derivatives(
        self, q: FloatArray, nu: FloatArray, a: FloatArray, pi: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the generalised force's derivatives at parameters pi, all of 6 + n rows.

        They are those by q (n columns), by nu (6 + n) and by the acceleration, which is H.
        """
        for joint in range(1, self.model.njoints):
            own = pi[COUNT * (joint - 1) : COUNT * joint]
            self.model.inertias[joint] = pin.Inertia.FromDynamicParameters(own)
        self._pose(q)
        pin.computeRNEADerivatives(self.model, self.data, self._q, nu, a)
        H = np.triu(self.data.M)  # Pinocchio fills the upper triangle
        H = H + np.triu(H, 1).T
        return np.array(self.data.dtau_dq[:, 6:]), np.array(self.data.dtau_dv), H

    def give(self, H_bb: FloatArray, force: FloatArray) -> FloatArray:
        """Return the base's acceleration under forces (6,) or (6, k), with the stand if any."""
        if self.stand is None:
            return np.asarray(np.linalg.solve(H_bb, force))
        return self.stand.give(H_bb, force)

    @property
    def support(self) -> FloatArray:
        """Return the acceleration (6,) by which a stand balances gravity; zero without a stand."""
        gravity = (0.0, 0.0, 0.0) if self.stand is None else self.stand.gravity_m_s2
        return np.concatenate((-np.array(gravity), np.zeros(3)))

    def tool_pose(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return R_BE (3, 3) and p_BE_B (3,) of the tool frame."""
        self._pose(q)
        pin.framesForwardKinematics(self.model, self.data, self._q)
        pose = self.data.oMf[self._tool]
        return np.array(pose.rotation), np.array(pose.translation)
