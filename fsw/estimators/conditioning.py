"""Signal conditioning: from a window of samples to a block of nodes where all is known at once.

Every channel, and the derivatives qd, qdd and wd, is read at the same Gauss-Legendre instants, with
the covariance that its samples' white noise leaves. Outliers are removed by their distance from the
window's own polynomial and counted.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from fsw.config import Config
from fsw.estimators.model.problem import joint_order
from fsw.estimators.model.robot import RobotModel
from fsw.estimators.polynomial import NodeFit, gauss_nodes
from fsw.estimators.stages import complete
from fsw.messages import Block, ChannelWindow, FloatArray, Window
from fsw.messages.findings import Fault, Finding

GATE_SIGMAS = 6.0  # one false alarm in 5e8 white samples
STILL_PROBABILITY = 1e-6  # of calling a joint at rest a moving one, per window
MAX_PASSES = 12  # of removing outliers and fitting again; a window that needs more is junk
ANGLE_NOISE_RAD = 1e-5  # of a sample: beyond it the angles' own errors are told beside the rates'
SPIKE_RATIO = 0.05  # of a window's samples; more outliers mean that the channel is not to be used
MIN_SPIKES = 3
EXTRA_POSITION_DEGREE = 3  # the position's polynomial must still have a good second derivative
GYRO_FAULTS = ("gyro", Fault.GYRO_SPIKE, Fault.GYRO_INCONSISTENT)
ACC_FAULTS = ("accelerometer", Fault.ACC_SPIKE, Fault.ACC_INCONSISTENT)


def rotation_from_xyzw(q: FloatArray) -> FloatArray:
    """Return the rotation matrices (..., 3, 3) of unit quaternions (..., 4) in xyzw order."""
    x, y, z, w = np.moveaxis(np.asarray(q, float), -1, 0)
    R = np.empty((*x.shape, 3, 3))
    R[..., 0, 0], R[..., 1, 1] = 1 - 2 * (y * y + z * z), 1 - 2 * (x * x + z * z)
    R[..., 2, 2] = 1 - 2 * (x * x + y * y)
    R[..., 0, 1], R[..., 1, 0] = 2 * (x * y - z * w), 2 * (x * y + z * w)
    R[..., 0, 2], R[..., 2, 0] = 2 * (x * z + y * w), 2 * (x * z - y * w)
    R[..., 1, 2], R[..., 2, 1] = 2 * (y * z - x * w), 2 * (y * z + x * w)
    return R


class Conditioner:
    """Turns windows into blocks; keeps only counters.

    `order[k]` is the index, in the configured joint list, of the model's joint k.
    """

    def __init__(self, config: Config, order: tuple[int, ...]) -> None:
        self._nodes = config.estimator.nodes
        self._min_fill = config.estimator.min_fill_ratio
        self._order = order
        self._joints = tuple(config.joints[k] for k in order)
        noisy = max(joint.position_noise_rad for joint in self._joints) > ANGLE_NOISE_RAD
        self._orders = (1, 2, 0) if noisy else (1, 2)
        imu = config.imu
        self._R_BS = rotation_from_xyzw(np.array(imu.mounting.q_BS_xyzw))
        self._sigma_gyro = imu.angle_random_walk_rad_sqrt_s * imu.rate_hz**0.5
        self._sigma_acc = imu.velocity_random_walk_m_s_sqrt_s * imu.rate_hz**0.5
        self.outliers = 0
        self.unusable_windows = 0
        self._R_NB = np.eye(3)
        self._attitude_ns = 0
        self._attitude_known = False
        self._found: list[Finding] = []

    def findings(self) -> list[Finding]:
        """Return and forget what was found wrong in the windows."""
        found, self._found = self._found, []
        return found

    def condition(self, window: Window) -> Block | None:
        """Return the block of a window, or None when the arm's motion cannot be known in it."""
        return complete(self.stages(window))

    def stages(self, window: Window) -> Generator[None, None, Block | None]:
        """Do what `condition` does in bounded units, a channel each.

        A joint without position makes the window unusable; a missing gyro or accelerometer is
        marked in the block and its rows stay out of the update.
        """
        m, n = self._nodes, len(self._order)
        centre_ns = (window.start_ns + window.stop_ns) // 2
        half_s = (window.stop_ns - window.start_ns) * 0.5e-9
        joints = [window.joints[k] for k in self._order]
        if any(joint.missing for joint in joints):
            self.unusable_windows += 1
            return None
        q, qd, qdd, tau = (np.zeros((m, n)) for _ in range(4))
        size = len(self._orders) * m
        cov_joint = np.empty((n, size, size))
        cov_tau = np.broadcast_to(np.eye(m), (n, m, m)).copy()
        has_joint = np.ones(n, dtype=bool)
        shared: _JointFits | None = None
        for k, (joint, channel) in enumerate(zip(self._joints, joints, strict=True)):
            t_s = _seconds(channel, centre_ns)
            if shared is None or not shared.fits(t_s):
                shared = _JointFits(t_s, half_s, m)
            position = shared.solve_position(channel.values[:, 0], joint.position_noise_rad)
            self._tell(position.removed, Fault.ENCODER_SPIKE, joint.name, window)
            if position.fit is None:
                self.unusable_windows += 1
                return None
            torque = shared.solve_torque(
                channel.values[:, 1], joint.torque_noise_nm, self._min_fill
            )
            if self._is_doubtful(torque.removed, len(t_s)):
                self._tell(torque.removed, Fault.TORQUE_INCONSISTENT, joint.name, window)
                torque = NO_FIT
            self._tell(torque.removed, Fault.TORQUE_SPIKE, joint.name, window)
            q[:, k] = position.fit.operator(0) @ position.coefficients
            qd[:, k] = position.fit.operator(1) @ position.coefficients
            qdd[:, k] = position.fit.operator(2) @ position.coefficients
            cov_joint[k] = position.fit.covariance(self._orders, joint.position_noise_rad)
            has_joint[k] = torque.fit is not None
            if torque.fit is not None:
                tau[:, k] = torque.fit.operator(0) @ torque.coefficients
                cov_tau[k] = torque.fit.covariance((0,), joint.torque_noise_nm)
            yield
        still = _still(qd, qdd, cov_joint[:, : 2 * m, : 2 * m])
        qd[:, still] = qdd[:, still] = 0.0
        yield
        gyro, cov_gyro, has_gyro = self._inertial(
            window, window.gyro, self._sigma_gyro, (0, 1), GYRO_FAULTS
        )
        yield
        force, cov_acc, has_acc = self._inertial(
            window, window.accelerometer, self._sigma_acc, (0,), ACC_FAULTS
        )
        yield
        t_ns = centre_ns + np.rint(gauss_nodes(m) * half_s * 1e9).astype(np.int64)
        R_NB = self._attitude(window.attitude, t_ns, (gyro[:m] @ self._R_BS.T).mean(axis=0))
        return Block(
            index=window.index,
            t_ns=t_ns,
            q_rad=q,
            qd_rad_s=qd,
            qdd_rad_s2=qdd,
            tau_nm=tau,
            w_NB_B_rad_s=gyro[:m] @ self._R_BS.T,
            wd_NB_B_rad_s2=gyro[m:] @ self._R_BS.T,
            f_NS_B_m_s2=force @ self._R_BS.T,
            R_NB=R_NB,
            cov_joint=cov_joint,
            cov_tau=cov_tau,
            cov_gyro=cov_gyro,
            cov_acc=cov_acc,
            has_joint=has_joint,
            has_gyro=has_gyro,
            has_accelerometer=has_acc,
            has_attitude=self._attitude_known,
        )

    def _attitude(
        self, channel: ChannelWindow, t_ns: NDArray[np.int64], w_NB_B: FloatArray
    ) -> FloatArray:
        """Return R_NB (m, 3, 3) at the nodes: the nearest solution, turned on by the window's rate.

        Without a solution in the window the last one is propagated by the gyro; before the first
        one the attitude is not known and the identity stands for it.
        """
        known_ns, known = channel.t_ns, rotation_from_xyzw(channel.values)
        if channel.missing or len(known_ns) == 0:
            known_ns, known = np.array([self._attitude_ns]), self._R_NB[None]
        else:
            self._attitude_known = True
        if not self._attitude_known:
            return np.broadcast_to(np.eye(3), (len(t_ns), 3, 3)).copy()
        nearest = np.abs(known_ns[None, :] - t_ns[:, None]).argmin(axis=1)
        since_s = np.asarray(t_ns - known_ns[nearest], dtype=np.float64) * 1e-9
        R_NB: FloatArray = known[nearest] @ rotation_from_xyzw(_turn(since_s[:, None] * w_NB_B))
        self._R_NB, self._attitude_ns = R_NB[-1], int(t_ns[-1])
        return R_NB

    def _inertial(
        self,
        window: Window,
        channel: ChannelWindow,
        sigma: float,
        orders: tuple[int, ...],
        faults: tuple[str, Fault, Fault],
    ) -> tuple[FloatArray, FloatArray, bool]:
        """Return stacked derivatives at the nodes (len(orders) m, 3), their covariance, usable."""
        m = self._nodes
        if not channel.missing:
            subject, spike, inconsistent = faults
            half_s = (window.stop_ns - window.start_ns) * 0.5e-9
            t_s = _seconds(channel, (window.start_ns + window.stop_ns) // 2)
            fit = NodeFit(t_s, half_s, m - 1, m)
            found = _robust(fit, t_s, half_s, (m - 1, m), channel.values, sigma, 2 * m)
            if self._is_doubtful(found.removed, len(t_s)):
                self._tell(found.removed, inconsistent, subject, window)
            else:
                self._tell(found.removed, spike, subject, window)
                if found.fit is not None:
                    E = np.concatenate([found.fit.operator(order) for order in orders])
                    return E @ found.coefficients, found.fit.covariance(orders, sigma), True
        rows = m * len(orders)
        return np.zeros((rows, 3)), np.eye(rows), False

    @staticmethod
    def _is_doubtful(removed: int, samples: int) -> bool:
        return removed > max(MIN_SPIKES, SPIKE_RATIO * samples)

    def _tell(self, removed: int, fault: Fault, subject: str, window: Window) -> None:
        self.outliers += removed
        if removed:
            text = f"{removed} samples off the window's polynomial"
            self._found.append(Finding(window.stop_ns, fault, subject, text))


@dataclass(frozen=True, slots=True, eq=False)
class _Robust:
    """A polynomial without its outliers; fit None: none can be had."""

    fit: NodeFit | None
    coefficients: FloatArray
    removed: int


NO_FIT = _Robust(None, np.empty(0), 0)


def _robust(
    fit: NodeFit,
    t_s: FloatArray,
    half_s: float,
    shape: tuple[int, int],
    values: FloatArray,
    sigma: float,
    least: int,
) -> _Robust:
    """Fit values (k, width) of one channel, leaving outliers out.

    Parameters
    ----------
    fit : polynomial over all the instants t_s (k,); `shape` is its degree and number of nodes
    least : samples that must be left
    """
    keep, removed = np.ones(len(t_s), dtype=bool), 0
    for _ in range(MAX_PASSES):
        coefficients = fit.coefficients(values[keep])
        good = _inliers(fit.residuals(values[keep], coefficients), sigma)
        if good.all():
            return _Robust(fit, coefficients, removed)
        removed += int(np.sum(~good))
        keep[keep] = good
        if keep.sum() < least:
            break
        fit = NodeFit(t_s[keep], half_s, *shape)
    return _Robust(None, np.empty(0), removed)


class _JointFits:
    """The two polynomials of one joint's window; joints latched by the same SYNCs share them."""

    def __init__(self, t_s: FloatArray, half_s: float, nodes: int) -> None:
        self._t_s = t_s
        self._half_s = half_s
        self._nodes = nodes
        self.position = NodeFit(t_s, half_s, nodes - 1 + EXTRA_POSITION_DEGREE, nodes)
        self.torque = NodeFit(t_s, half_s, nodes - 1, nodes)

    def fits(self, t_s: FloatArray) -> bool:
        return np.array_equal(t_s, self._t_s)

    def solve_position(self, values: FloatArray, sigma: float) -> _Robust:
        """Return the position's polynomial."""
        degree = self._nodes - 1 + EXTRA_POSITION_DEGREE
        shape, least = (degree, self._nodes), 2 * (self._nodes + EXTRA_POSITION_DEGREE)
        return self._column(self.position, self._t_s, shape, values, sigma, least)

    def solve_torque(self, values: FloatArray, sigma: float, min_fill: float) -> _Robust:
        """Return the torque's polynomial over the samples that have one; not over too few."""
        shape, t_s, fit = (self._nodes - 1, self._nodes), self._t_s, self.torque
        usable = np.isfinite(values)
        if not usable.all():
            if usable.sum() < max(min_fill * len(values), 2 * self._nodes):
                return NO_FIT
            t_s, values = t_s[usable], values[usable]
            fit = NodeFit(t_s, self._half_s, *shape)
        return self._column(fit, t_s, shape, values, sigma, 2 * self._nodes)

    def _column(
        self,
        fit: NodeFit,
        t_s: FloatArray,
        shape: tuple[int, int],
        values: FloatArray,
        sigma: float,
        least: int,
    ) -> _Robust:
        found = _robust(fit, t_s, self._half_s, shape, values[:, None], sigma, least)
        return replace(found, coefficients=found.coefficients.reshape(-1))


def _still(qd: FloatArray, qdd: FloatArray, covariance: FloatArray) -> NDArray[np.bool_]:
    """Return (n,) which joints' motion is nothing but the noise of [qd, qdd], (n, 2m, 2m).

    A joint at rest is taken at rest. Otherwise the regressor would be made of noise, which looks
    like information and shrinks whatever it is about (errors in variables).
    """
    motion = np.concatenate([qd, qdd]).T
    # the covariance's rank is the polynomial's degree; the pseudo-inverse leaves the rest out
    values, vectors = np.linalg.eigh(covariance)
    kept = values > 1e-9 * values[:, -1:]
    parts = np.einsum("jki,jk->ji", vectors, motion) ** 2 / np.where(kept, values, np.inf)
    return np.asarray(parts.sum(axis=1) <= chdtri(kept.sum(axis=1), STILL_PROBABILITY))


def _seconds(channel: ChannelWindow, centre_ns: int) -> FloatArray:
    return np.asarray(channel.t_ns - centre_ns, dtype=np.float64) * 1e-9


def _inliers(residuals: FloatArray, sigma: float) -> np.ndarray:
    """Return (k,) which samples lie within the gate on every axis.

    The scale is the larger of the declared noise and the window's own median deviation, so that a
    noisier sensor than declared degrades instead of losing every sample. The worst go first: an
    outlier bends the fit, and good samples near it must not be left out with it.
    """
    size = np.abs(residuals)
    middle = len(size) // 2
    median = np.partition(size, middle, axis=0)[middle]  # np.median is ten times as slow
    ratio = np.max(size / np.maximum(sigma, 1.4826 * median), axis=1)
    good: np.ndarray = ratio <= np.maximum(GATE_SIGMAS, 0.5 * ratio.max())
    return good


def _turn(angle_rad: FloatArray) -> FloatArray:
    """Return the quaternions (..., 4) xyzw of rotation vectors (..., 3)."""
    half = 0.5 * np.linalg.norm(angle_rad, axis=-1, keepdims=True)
    return np.concatenate([0.5 * np.sinc(half / np.pi) * angle_rad, np.cos(half)], axis=-1)


def build_conditioner(config: Config, model: RobotModel) -> Conditioner:
    """Build the conditioner of a configuration for its robot."""
    return Conditioner(config, joint_order(config, model))
