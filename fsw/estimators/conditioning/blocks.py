"""Signal conditioning: from windows of samples to blocks of values at common instants (nodes).

Every channel, and the derivatives qd, qdd and wd, is evaluated at the same Gauss-Legendre instants,
with the covariance that its samples' white noise leaves. Channels sampled at the same instants
share one operator; windows given together are fitted by one matrix product. Outliers are counted
and removed, channel by channel, by their distance from the window's own polynomial.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.config import Config
from fsw.estimators.conditioning.arm_motion import (
    ArmConditioner,
    ArmWanted,
    is_doubtful,
    tells_of_noise,
)
from fsw.estimators.conditioning.polynomial import EXTRA_DEGREE, gauss_nodes
from fsw.estimators.conditioning.rotation import rotation_from_xyzw
from fsw.estimators.conditioning.window_fit import NO_FIT, Fitted, Instants, Wanted, fit_windows
from fsw.estimators.conditioning.wrench_fit import WrenchConditioner
from fsw.estimators.effects.device import Part
from fsw.estimators.effects.registered import DEVICES
from fsw.estimators.model.building import imu_samples, joint_order
from fsw.estimators.model.robot import RobotModel
from fsw.estimators.noise.found import LAGS
from fsw.messages import Block, ChannelWindow, FloatArray, Window
from fsw.messages.findings import Fault, Finding

GYRO_FAULTS = ("gyro", Fault.GYRO_SPIKE, Fault.GYRO_INCONSISTENT)
ACC_FAULTS = ("accelerometer", Fault.ACC_SPIKE, Fault.ACC_INCONSISTENT)


@dataclass(frozen=True, slots=True, eq=False)
class _Asked:
    """A window and the fits that it needs."""

    window: Window
    t_ns: NDArray[np.int64]  # (m,) of the nodes
    devices: list[Part]  # of the block, by each kind of device that the base has
    arm: ArmWanted | None  # None: a joint's samples are missing
    wrenches: list[Wanted | None]  # of each wrench sensor; None: missing
    gyro: Wanted | None  # None: missing; likewise the accelerometer
    accelerometer: Wanted | None

    @property
    def wanted(self) -> list[Wanted]:
        """Return all fits, in order."""
        others = (*self.wrenches, self.gyro, self.accelerometer)
        joints = () if self.arm is None else self.arm.wanted
        return [*joints, *(own for own in others if own is not None)]


class Conditioner:
    """Turns windows into blocks; keeps counters, the last attitude, and newest samples of devices.

    `order[k]` is the index, in the configured joint list, of the model's joint k.
    """

    def __init__(self, config: Config, order: tuple[int, ...]) -> None:
        self._nodes = config.estimator.nodes
        self._arm = ArmConditioner(config, order)
        self._wrenches = WrenchConditioner(config)
        self.speeds = self._arm.speeds
        self._names = [config.joints[k].name for k in order]
        imu = config.imu
        self._R_BS = rotation_from_xyzw(np.array(imu.mounting.q_BS_xyzw))
        self._sigma_gyro = imu.angle_random_walk_rad_sqrt_s * imu.rate_hz**0.5
        self._sigma_acc = imu.velocity_random_walk_m_s_sqrt_s * imu.rate_hz**0.5
        self._imu_samples = imu_samples(config)
        self._devices = [own for kind in DEVICES for own in kind.followers(config)]
        self._momentum_lost = False
        self.outliers = 0
        self.unusable_windows = 0
        self._R_NB = np.eye(3)
        self._attitude_ns = 0
        self._attitude_known = False
        self._found: list[Finding] = []

    def findings(self) -> list[Finding]:
        """Return and discard the findings in the windows so far."""
        found, self._found = self._found, []
        return found

    def condition(self, window: Window) -> Block | None:
        """Return the block of one window, as `blocks` does."""
        return self.blocks((window,))[0]

    def blocks(self, windows: Sequence[Window]) -> list[Block | None]:
        """Return the block of each window, in order; None where the motion cannot be known.

        A window is unusable if a joint's position or the state of a device is unknown. A missing
        gyro or accelerometer is marked in the block, and its rows are not used.
        Windows given together have the same blocks as windows given one by one.
        """
        asked = [self._asked(window) for window in windows]
        fitted = iter(fit_windows([wanted for own in asked for wanted in own.wanted]))
        return [self._block(own, fitted) for own in asked]

    def _asked(self, window: Window) -> _Asked:
        half_s = (window.stop_ns - window.start_ns) * 0.5e-9
        centre_ns = (window.start_ns + window.stop_ns) // 2
        t_ns = centre_ns + np.rint(gauss_nodes(self._nodes) * half_s * 1e9).astype(np.int64)
        devices = [own.at(window, t_ns) for own in self._devices]
        gated = all(part.is_smooth for part in devices)
        return _Asked(
            window,
            t_ns,
            devices,
            self._arm.wanted(window, gated=gated),
            self._wrenches.wanted(window, gated=gated),
            self._inertial(window, window.gyro, self._sigma_gyro, (0, 1), gated=gated),
            self._inertial(window, window.accelerometer, self._sigma_acc, (0,), gated=gated),
        )

    def _block(self, asked: _Asked, fitted: Iterator[Fitted]) -> Block | None:
        """Return the block of a window, whose fits are the next ones of `fitted`."""
        m, window, arm = self._nodes, asked.window, None
        for part in asked.devices:
            self.outliers += part.removed
            self._found += part.findings
            self._momentum_lost |= part.loses_momentum
        if asked.arm is not None:
            own = [next(fitted) for _ in asked.arm.wanted]
            arm, removed = self._arm.made(asked.arm, own, window.start_ns, window.stop_ns)
            for k, fault, count in removed:
                self._note(count, fault, self._names[k], window)
        axes, left = self._wrenches.made(asked.wrenches, fitted)
        for name, fault, count in left:
            self._note(count, fault, name, window)
        inertial = [
            None if own is None else next(fitted) for own in (asked.gyro, asked.accelerometer)
        ]
        if self.speeds.lost:
            text = "its angle is lost in a gap of its speed; begin again where start_rad holds"
            for k in self.speeds.own:
                self._found.append(
                    Finding(window.stop_ns, Fault.ENCODER_FAULT, self._names[k], text)
                )
            arm = None
        if arm is None or any(part.fields is None for part in asked.devices):
            self.unusable_windows += 1
            return None
        gyro, cov_gyro, has_gyro, left_gyro = self._measured(
            window, inertial[0], self._sigma_gyro, (0, 1), GYRO_FAULTS
        )
        force, cov_acc, has_acc, left_acc = self._measured(
            window, inertial[1], self._sigma_acc, (0,), ACC_FAULTS
        )
        rate = gyro @ self._R_BS.T
        return Block(
            index=window.index,
            t_ns=asked.t_ns,
            q_rad=arm.motion[0],
            qd_rad_s=arm.motion[1],
            qdd_rad_s2=arm.motion[2],
            tau_nm=np.concatenate([arm.tau_nm, axes.tau], axis=1),
            w_NB_B_rad_s=rate[:m],
            wd_NB_B_rad_s2=rate[m:],
            f_NS_B_m_s2=force @ self._R_BS.T,
            R_NB=self._attitude(window.attitude, asked.t_ns, rate[:m].mean(axis=0)),
            cov_joint=arm.cov_joint,
            cov_tau=np.concatenate([arm.cov_tau, axes.cov_tau]),
            cov_gyro=cov_gyro,
            cov_acc=cov_acc,
            tau_products_nm2=np.concatenate([arm.tau_products_nm2, axes.products], axis=1),
            has_joint=np.concatenate([arm.has_joint, axes.has]),
            imu_products=np.stack([left_gyro, left_acc], axis=1),
            has_gyro=has_gyro,
            has_accelerometer=has_acc,
            has_attitude=self._attitude_known and not self._momentum_lost,
            walk_rad2=arm.walk_rad2,
            **{key: value for part in asked.devices for key, value in (part.fields or {}).items()},
        )

    def _attitude(
        self, channel: ChannelWindow, t_ns: NDArray[np.int64], w_NB_B: FloatArray
    ) -> FloatArray:
        """Return R_NB (m, 3, 3) at the nodes: the nearest solution, turned by the window's rate.

        Without a solution in the window the last attitude is propagated by the gyro. Before the
        first solution the attitude is unknown, and R_NB is the identity.
        """
        is_new = not channel.missing and len(channel.t_ns) > 0
        self._attitude_known |= is_new
        if not self._attitude_known:
            return np.broadcast_to(np.eye(3), (len(t_ns), 3, 3)).copy()
        known_ns = channel.t_ns if is_new else np.array([self._attitude_ns])
        nearest = np.abs(known_ns[None, :] - t_ns[:, None]).argmin(axis=1)
        since_s = np.asarray(t_ns - known_ns[nearest], dtype=np.float64) * 1e-9
        turns = _turn(since_s[:, None] * w_NB_B)
        solved = channel.values[nearest] if is_new else turns[:0]
        R = rotation_from_xyzw(np.concatenate([turns, solved]))
        R_NB: FloatArray = (R[len(t_ns) :] if is_new else self._R_NB) @ R[: len(t_ns)]
        self._R_NB, self._attitude_ns = R_NB[-1], int(t_ns[-1])
        return R_NB

    def _inertial(
        self,
        window: Window,
        channel: ChannelWindow,
        sigma: float,
        orders: tuple[int, ...],
        *,
        gated: bool,
    ) -> Wanted | None:
        """Return the fit that a channel of the inertial unit needs; None: the channel is missing.

        A window does not count for the noise if it has too few samples for the highest polynomial,
        or if a force changes in it.
        """
        if channel.missing:
            return None
        m, half_s = self._nodes, (window.stop_ns - window.start_ns) * 0.5e-9
        offsets_ns = channel.t_ns - (window.start_ns + window.stop_ns) // 2
        high, count = m - 1 + EXTRA_DEGREE, len(channel.t_ns)
        enough = count > high + 1
        tells = gated and enough and tells_of_noise(count / self._imu_samples)
        return Wanted(
            Instants(offsets_ns.tobytes(), half_s, m, high if enough else m - 1),
            channel.values,
            np.array([sigma if gated else np.inf]),
            m - 1,
            orders,
            width=3,
            samples=self._imu_samples if tells else 0,
        )

    def _measured(
        self,
        window: Window,
        fitted: Fitted | None,
        sigma: float,
        orders: tuple[int, ...],
        faults: tuple[str, Fault, Fault],
    ) -> tuple[FloatArray, FloatArray, bool, FloatArray]:
        """Return derivatives at the nodes (len(orders) m, 3), covariance, usable or not, products.

        The mean products (L,) are those of the three axes; zero if they do not count for the noise.
        """
        found, products, rows = NO_FIT, np.zeros(len(LAGS)), self._nodes * len(orders)
        if fitted is not None:
            (found,), (subject, spike, inconsistent) = fitted.channels, faults
            if is_doubtful(found.removed, fitted.samples):
                self._note(found.removed, inconsistent, subject, window)
                found = NO_FIT
            self._note(found.removed, spike, subject, window)
            if found.fit is not None and not found.removed:
                products = fitted.products.mean(axis=1)
        values = np.zeros((rows, 3)) if found.fit is None else found.values
        return values, found.covariance(orders, sigma, rows), found.fit is not None, products

    def _note(self, removed: int, fault: Fault, subject: str, window: Window) -> None:
        self.outliers += removed
        if removed:
            text = f"{removed} samples off the window's polynomial"
            self._found.append(Finding(window.stop_ns, fault, subject, text))


def _turn(angle_rad: FloatArray) -> FloatArray:
    """Return the quaternions (..., 4) xyzw of rotation vectors (..., 3)."""
    half = 0.5 * np.linalg.norm(angle_rad, axis=-1, keepdims=True)
    return np.concatenate([0.5 * np.sinc(half / np.pi) * angle_rad, np.cos(half)], axis=-1)


def build_conditioner(config: Config, model: RobotModel) -> Conditioner:
    """Build the conditioner of a configuration for its robot."""
    return Conditioner(config, joint_order(config, model))
