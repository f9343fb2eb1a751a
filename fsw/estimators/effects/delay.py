"""Constant delays that nobody knows: of a torque against its angle, of a bus, of the inertial unit.

A reading with stamp t and delay d shows the robot at t - d. The joints' motion is known at the m
nodes of a window, so the polynomial of degree m - 1 through a channel's m predictions is shifted,

    y(t - d) = sum over k < m of (-d D)^k / k!  y(t),        d/dd y(t - d) = -D y(t - d)

with D (m, m) the derivative of the interpolant at the nodes. D is nilpotent, so the sum is exact
for that polynomial, and the remainder of first order, (w d)^2 / 2 of a motion of rate w, does not
arise. What remains is the part of degree m and above: w^m d (T/2)^(m-1) in size, T the window. At
10 ms, 0.4 s and 4 nodes it is 0.6 % of the amplitude of a motion of 1 Hz, 0.005 % at 0.3 Hz.

The delay of a torque adds to that of its bus. The clock of the model is that of the first joint's
bus, so that the delay of the only bus is an advance of the inertial unit; with wheels or thrusters
it is the base's. The motion of a joint on another clock is taken at t + d, from its angle, rate and
the polynomial of its acceleration; its noise counts as at t. The two delays of the inertial unit
are those of gyro and accelerometer.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import factorial

import numpy as np
from numpy.typing import NDArray

from fsw.estimators.conditioning.polynomial import differentiation
from fsw.estimators.model.state_group import Setting, Spread, StateGroup, per_joint, per_part
from fsw.messages import FloatArray


def _of_unit(setting: Setting) -> Spread:
    return ("gyro", "accelerometer"), [setting.config.imu.delay_sigma_s] * 2


TORQUE = StateGroup(  # of a joint's torque, relative to its angle
    name="torque_delay",
    effect="delays of torques",
    unit="s",
    key="joints[].torque_delay_sigma_s",
    prior=per_joint("torque_delay_sigma_s"),
    calibrated_from=0.01,
    is_judged=True,
    is_repeated=True,
    is_steady=True,
    mistake="stamps of torques and angles",
)
BUS = StateGroup(  # of its joints' samples; of a single bus, that of the unit the other way
    name="bus_delay",
    effect="delays of buses",
    unit="s",
    key="buses[].delay_sigma_s",
    prior=per_part("buses", "delay_sigma_s"),
    is_possible=lambda config: config.imu.present and len(config.buses) > 1,
    is_judged=True,
    is_repeated=True,
    is_steady=True,
    mistake="latch_offset_s of buses",
)
IMU = StateGroup(  # true delays minus the configured ones
    name="imu_delay",
    effect="delays of the inertial unit",
    unit="s",
    key="imu.delay_sigma_s",
    prior=_of_unit,
    calibrated_from=0.02,
    is_possible=lambda config: bool(config.joints),
    is_judged=True,
    is_repeated=True,
    is_steady=True,
    axes=("gyro", "accelerometer"),
    mistake="gyro_group_delay_s and acc_group_delay_s",
)
GROUPS = (TORQUE, BUS, IMU)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Delays:
    """Delays of t torques, then of specific force and rate, as linear functions of the state.

    Attributes
    ----------
    known_s : (t + 6,) delay of each channel as configured
    states : (k,) places of the delays in the state
    of_channels : (t + 6, k) by how much each counts for a channel
    of_joints : (n, k) likewise for the stamps of a joint's motion
    """

    known_s: FloatArray
    states: NDArray[np.intp]
    of_channels: FloatArray
    of_joints: FloatArray
    window_s: float

    def __bool__(self) -> bool:
        """Whether a channel may have a delay."""
        return bool(len(self.states)) or bool(self.known_s.any())

    @property
    def moves_joints(self) -> bool:
        """Whether stamps of a joint's motion are in doubt."""
        return bool(self.of_joints.any())

    def late(self, x: FloatArray, values: FloatArray, J: FloatArray, nodes: int) -> FloatArray:
        """Return values (N, c) of the first c channels, delayed; change J (N, c, p) in place."""
        W, late_s = self.of_channels[: values.shape[1]], self._late_s(x)[: values.shape[1]]
        own = np.flatnonzero(W.any(axis=1) | (late_s != 0.0))
        E, found = self._shifts(-late_s[own], nodes), values.copy()
        found[:, own], J[:, own] = _by_window(E, values[:, own]), _by_window(E, J[:, own])
        slope = self.slope(found[:, own], nodes)
        J[:, own[:, None], self.states] -= slope[:, :, None] * W[own]
        return found

    def back(self, x: FloatArray, nodes: int) -> FloatArray:
        """Return (t + 6, m, m), which removes the delay from a channel's values at the m nodes."""
        return self._shifts(self._late_s(x), nodes)

    def prompt(self, x: FloatArray, values: FloatArray, nodes: int) -> FloatArray:
        """Return values (N, c, ...) of the last c channels without their delays."""
        return _by_window(self.back(x, nodes)[-values.shape[1] :], values)

    def advanced(
        self, x: FloatArray, q: FloatArray, qd: FloatArray, qdd: FloatArray, nodes: int
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the joints' angle, rate and acceleration (N, n) later by their stamps' delays."""
        d_s = self.of_joints @ x[self.states]
        folds = [_by_window(self._shifts(d_s, nodes, fold), qdd) for fold in range(3)]
        return q + d_s * qd + folds[2], qd + folds[1], folds[0]

    def by_motion(
        self, D: Sequence[FloatArray], rates: Sequence[FloatArray], nodes: int
    ) -> FloatArray:
        """Return derivatives (N, r, k) through the joints' motion.

        `D`: by angle, rate and acceleration (N, r, n); `rates`: rate and acceleration (N, n).
        """
        motion = (*rates, self.slope(rates[1], nodes))
        whole = sum(gains * own[:, None] for gains, own in zip(D, motion, strict=True))
        return np.asarray(whole @ self.of_joints)

    def slope(self, values: FloatArray, nodes: int) -> FloatArray:
        """Return the time derivatives (N, c) of channels (N, c)."""
        return _by_window(self._derivative(nodes)[None], values)

    def _late_s(self, x: FloatArray) -> FloatArray:
        late_s: FloatArray = self.known_s + self.of_channels @ x[self.states]
        return late_s

    def _derivative(self, nodes: int) -> FloatArray:
        return differentiation(nodes) * (2.0 / self.window_s)

    def _shifts(self, by_s: FloatArray, nodes: int, fold: int = 0) -> FloatArray:
        """Return (c, m, m): from values to those `by_s` (c,) later, integrated `fold` times."""
        found, power = np.zeros((len(by_s), nodes, nodes)), np.eye(nodes)
        for k in range(fold, nodes + fold):
            found += (by_s**k / factorial(k))[:, None, None] * power
            power = power @ self._derivative(nodes)
        return found


def _by_window(E: FloatArray, values: FloatArray) -> FloatArray:
    """Return E (c or 1, m, m) applied to the nodes of each window of values (N, c, ...)."""
    m = E.shape[-1]
    by = values.reshape(-1, m, values.shape[1], int(np.prod(values.shape[2:])))
    shifted: FloatArray = (E @ by.transpose(0, 2, 1, 3)).transpose(0, 2, 1, 3)
    return shifted.reshape(values.shape)


def delays(setting: Setting, places: Mapping[str, slice], torques: int) -> Delays:
    """Return the delays of a configuration.

    Parameters
    ----------
    places : slice of each group of states in the whole state
    torques : number of torque channels: joints, then axes of wrench sensors
    """
    config, joints = setting.config, setting.joints
    at = [np.r_[places.get(group.name, slice(0, 0))].astype(np.intp) for group in GROUPS]
    n, (own, buses, imu) = len(joints), (len(states) for states in at)
    of_joints, of_channels = (
        np.zeros((n, own + buses + imu)),
        np.zeros((torques + 6, own + buses + imu)),
    )
    of_channels[:n, :own] = np.eye(n)[:, :own]
    if buses:
        k = slice(own, own + buses)
        of_joints[:, k] = [[joint.bus == bus.name for bus in config.buses] for joint in joints]
        of_channels[:n, k] = of_joints[:, k]
        if not (config.wheels or config.thrusters):  # the first joint's bus keeps the time
            first = of_joints[0].copy()
            of_joints -= first
            of_channels -= first
    if imu:
        of_channels[torques + 3 :, -2] = of_channels[torques : torques + 3, -1] = 1.0
    known_s = np.zeros(torques + 6)
    known_s[:n] = [joint.torque_delay_s for joint in joints]
    return Delays(
        known_s=known_s,
        states=np.concatenate(at),
        of_channels=of_channels,
        of_joints=of_joints,
        window_s=config.estimator.window_s,
    )
