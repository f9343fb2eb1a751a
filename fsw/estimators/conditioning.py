"""Signal conditioning: from a window of samples to a block of nodes where all is known at once.

Every channel, and the derivatives qd, qdd and wd, is read at the same Gauss-Legendre instants, with
the covariance that its samples' white noise leaves. Channels sampled at the same instants share one
operator and are fitted by one matrix product. Outliers are removed, channel by channel, by their
distance from the window's own polynomial and counted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from fsw.config import Config
from fsw.estimators.found_noise import LAGS
from fsw.estimators.model.building import (
    imu_samples,
    joint_order,
    torque_model_covariance,
    torque_samples,
)
from fsw.estimators.model.problem import Thrusters
from fsw.estimators.model.robot import RobotModel
from fsw.estimators.polynomial import EXTRA_DEGREE, gauss_nodes
from fsw.estimators.reversal import doubt
from fsw.estimators.rotation import rotation_from_xyzw
from fsw.estimators.speed_motion import SpeedMotion
from fsw.estimators.valves import Valves, changes
from fsw.estimators.wheel_motion import Turn, WheelMotion
from fsw.estimators.window_fit import NO_FIT, ChannelFit, Instants
from fsw.messages import Block, ChannelWindow, FloatArray, Window
from fsw.messages.findings import Fault, Finding

STILL_PROBABILITY = 1e-6  # of calling a joint at rest a moving one, per window
ANGLE_NOISE_RAD = 1e-5  # of a sample: beyond it the angles' own errors are told beside the rates'
SPIKE_RATIO = 0.05  # of a window's samples; more outliers mean that the channel is not to be used
MIN_SPIKES = 3
SURPLUS_RATIO = 0.01  # of its samples that a window may have too many to count for the noise
LACKING_RATIO = 0.25  # that it may lack
MOTION = (0, 1, 2)  # derivatives of a joint's position
OF_SPEED = (-1, 0, 1)  # the same of its speed
SPEED_EXTRA_DEGREE = 1  # of a speed over a torque: one derivative is wanted, and its noise is large
GYRO_FAULTS = ("gyro", Fault.GYRO_SPIKE, Fault.GYRO_INCONSISTENT)
ACC_FAULTS = ("accelerometer", Fault.ACC_SPIKE, Fault.ACC_INCONSISTENT)


class Conditioner:
    """Turns windows into blocks; keeps counters, the last attitude, and newest wheel samples.

    `order[k]` is the index, in the configured joint list, of the model's joint k.
    """

    def __init__(self, config: Config, order: tuple[int, ...]) -> None:
        self._nodes = config.estimator.nodes
        self._min_fill = config.estimator.min_fill_ratio
        self._order = order
        self._joints = tuple(config.joints[k] for k in order)
        rates_hz = {bus.name: bus.rate_hz for bus in config.buses}
        self.speeds = SpeedMotion(self._joints, self._nodes, rates_hz)
        noisy = any(joint.position_noise_rad > ANGLE_NOISE_RAD for joint in self._joints)
        self._orders = (1, 2, 0) if noisy or self.speeds.own else (1, 2)
        self._position_sigma = np.array(
            [joint.speed_noise_rad_s or joint.position_noise_rad for joint in self._joints]
        )
        self._torque_sigma = np.array([joint.torque_noise_nm for joint in self._joints])
        self._coulomb_nm = np.array([joint.friction_coulomb_sigma_nm for joint in self._joints])
        self._speed_rad_s = np.array([joint.friction_speed_rad_s for joint in self._joints])
        self._samples = torque_samples(config, order)
        self._cov_model = torque_model_covariance(config, order)
        # friction that reverses is up to its size off the polynomial: no outlier up to 3 sigma
        left_out = np.array([joint.torque_model_sigma_nm for joint in self._joints])
        self._torque_gate = np.hypot(np.hypot(self._torque_sigma, 0.5 * self._coulomb_nm), left_out)
        imu = config.imu
        self._R_BS = rotation_from_xyzw(np.array(imu.mounting.q_BS_xyzw))
        self._sigma_gyro = imu.angle_random_walk_rad_sqrt_s * imu.rate_hz**0.5
        self._sigma_acc = imu.velocity_random_walk_m_s_sqrt_s * imu.rate_hz**0.5
        self._imu_samples = imu_samples(config)
        self._wheels = [WheelMotion(wheel) for wheel in config.wheels]
        self._valves = Valves(config.thrusters) if config.thrusters else None
        self._tail_s = Thrusters.of(config).tail_s
        self._momentum_lost = False  # a change of a valve was missed, or may have been
        self._newest = -1  # window
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
        """Return the block of a window, or None when the arm's motion cannot be known in it.

        A joint without position makes the window unusable; a missing gyro or accelerometer is
        marked in the block and its rows stay out of the update.
        """
        m = self._nodes
        centre_ns = (window.start_ns + window.stop_ns) // 2
        half_s = (window.stop_ns - window.start_ns) * 0.5e-9
        t_ns = centre_ns + np.rint(gauss_nodes(m) * half_s * 1e9).astype(np.int64)
        turns, firings = self._turns(window, t_ns), self._firings(window)
        edges = firings.get("edges") if firings else None
        changing = edges is not None and changes(edges, self._tail_s, -half_s)
        arm = self._arm(window, centre_ns, half_s, gated=not changing)
        if self.speeds.lost:
            text = "its angle is lost in a gap of its speed; begin again where start_rad holds"
            for k in self.speeds.own:
                name = self._joints[k].name
                self._found.append(Finding(window.stop_ns, Fault.ENCODER_FAULT, name, text))
            arm = None
        if arm is None or turns is None or firings is None:
            self.unusable_windows += 1
            return None
        gyro, cov_gyro, has_gyro, left_gyro = self._inertial(
            window, window.gyro, self._sigma_gyro, (0, 1), GYRO_FAULTS, gated=not changing
        )
        force, cov_acc, has_acc, left_acc = self._inertial(
            window, window.accelerometer, self._sigma_acc, (0,), ACC_FAULTS, gated=not changing
        )
        rate = gyro @ self._R_BS.T
        return Block(
            index=window.index,
            t_ns=t_ns,
            q_rad=arm.motion[0],
            qd_rad_s=arm.motion[1],
            qdd_rad_s2=arm.motion[2],
            tau_nm=arm.tau_nm,
            w_NB_B_rad_s=rate[:m],
            wd_NB_B_rad_s2=rate[m:],
            f_NS_B_m_s2=force @ self._R_BS.T,
            R_NB=self._attitude(window.attitude, t_ns, rate[:m].mean(axis=0)),
            cov_joint=arm.cov_joint,
            cov_tau=arm.cov_tau,
            cov_gyro=cov_gyro,
            cov_acc=cov_acc,
            tau_products_nm2=arm.tau_products_nm2,
            has_joint=arm.has_joint,
            imu_products=np.stack([left_gyro, left_acc], axis=1),
            has_gyro=has_gyro,
            has_accelerometer=has_acc,
            has_attitude=self._attitude_known and not self._momentum_lost,
            walk_rad2=arm.walk_rad2,
            **turns,
            **firings,
        )

    def _arm(self, window: Window, centre_ns: int, half_s: float, *, gated: bool) -> _Arm | None:
        """Return the arm's motion and torques; None where a joint's position cannot be known.

        Not `gated`, torques are no polynomials: none of their samples is an outlier.
        """
        channels = [window.joints[k] for k in self._order]
        if any(channel.missing for channel in channels):
            return None
        latched: dict[bytes, list[int]] = {}  # joints by the instants of their samples
        for k, channel in enumerate(channels):
            latched.setdefault(_offsets(channel, centre_ns), []).append(k)
        positions, torques = [NO_FIT] * len(channels), [NO_FIT] * len(channels)
        products = np.zeros((len(LAGS), len(channels)))
        high, low = self._nodes - 1 + EXTRA_DEGREE, self._nodes - 1
        for offsets_ns, own in latched.items():
            instants = Instants(offsets_ns, half_s, self._nodes, high)
            values = np.concatenate([channels[k].values for k in own], axis=1)
            for k, angle in self._motions(instants, values[:, ::2], own):
                positions[k] = angle
            forces = instants.fitted(
                values[:, 1::2],
                self._torque_gate[own] if gated else np.full(len(own), np.inf),
                low,
                (0,),
                min_fill=self._min_fill,
            )
            products[:, own] = instants.products(values[:, 1::2], int(self._samples[own[0]]))
            for k, force in zip(own, forces, strict=True):
                torques[k] = force
        for k, joint in enumerate(self._joints):
            self._note(positions[k].removed, Fault.ENCODER_SPIKE, joint.name, window)
            if positions[k].fit is None:
                return None
            if self._is_doubtful(torques[k].removed, len(channels[k].t_ns)):
                self._note(torques[k].removed, Fault.TORQUE_INCONSISTENT, joint.name, window)
                torques[k] = NO_FIT
            self._note(torques[k].removed, Fault.TORQUE_SPIKE, joint.name, window)
            counts = _counts(len(channels[k].t_ns) / self._samples[k])
            if torques[k].fit is None or torques[k].removed or not (counts and gated):
                products[:, k] = 0.0
        return self._joined(window, positions, torques, products)

    def _motions(
        self, instants: Instants, values: FloatArray, own: list[int]
    ) -> Iterator[tuple[int, ChannelFit]]:
        """Yield joints and their motion, stacked, from positions or speeds (k, joints).

        An angle by speed counts from the window's start.
        """
        by_speed = [k in self.speeds.own for k in own]
        low = self._nodes - 1 + SPEED_EXTRA_DEGREE
        for is_speed, degree, orders in ((False, instants.degree, MOTION), (True, low, OF_SPEED)):
            some = [place for place, own_speed in enumerate(by_speed) if own_speed == is_speed]
            if some:
                part = values if len(some) == len(own) else values[:, some]
                joints = [own[place] for place in some]
                fitted = instants.fitted(part, self._position_sigma[joints], degree, orders)
                yield from zip(joints, fitted, strict=True)

    def _turns(self, window: Window, t_ns: NDArray[np.int64]) -> dict[str, FloatArray] | None:
        """Return what a block holds of the wheels; None where a momentum cannot be known."""
        found: list[Turn | None] = []
        for wheel, channel in zip(self._wheels, window.wheels, strict=True):
            turn = None
            if not self._order:  # the body's motion is known by its gyro alone
                half_s = (window.stop_ns - window.start_ns) * 0.5e-9
                offsets_ns = _offsets(channel, (window.start_ns + window.stop_ns) // 2)
                instants = Instants(offsets_ns, half_s, self._nodes, self._nodes - 1)
                turn = wheel.along(channel, instants)
            turn = turn or wheel.at(channel, window.start_ns, t_ns)
            found.append(turn)
            if turn is not None:
                self.outliers += turn.removed
            elif not channel.stale:
                text = "its samples do not agree with one another"
                self._found.append(
                    Finding(window.stop_ns, Fault.WHEEL_INCONSISTENT, wheel.name, text)
                )
        known = [turn for turn in found if turn is not None]
        if len(known) < len(found):
            return None
        if not known:
            return {}
        return {
            "wheel_nms": np.stack([turn.h_nms for turn in known], axis=1),
            "wheel_nm": np.stack([turn.hd_nm for turn in known], axis=1),
            "cov_wheel": np.stack([turn.covariance for turn in known]),
        }

    def _firings(self, window: Window) -> dict[str, FloatArray] | None:
        """Return what a block holds of the thrusters; None where a valve's state is not known."""
        resumed, self._newest = self._newest < 0 < window.index, window.index
        if self._valves is None:
            return {}
        found, missed = self._valves.at(window.thrusters, window.start_ns, window.stop_ns)
        if missed:
            text = "a change was missed; the momentum is not used any more"
            self._found.append(Finding(window.stop_ns, Fault.THRUSTER_UNKNOWN, "valves", text))
        self._momentum_lost |= missed or resumed
        return found

    def _joined(
        self,
        window: Window,
        positions: list[ChannelFit],
        torques: list[ChannelFit],
        products: FloatArray,
    ) -> _Arm:
        m, n = self._nodes, len(positions)
        if n == 0:
            return _no_arm(m, len(self._orders) * m)
        fits = [position.fit for position in positions if position.fit is not None]
        motion = np.concatenate([position.values for position in positions], axis=1)
        for fit in dict.fromkeys(fits):
            own = np.array([k for k in range(n) if fits[k] is fit and k not in self.speeds.own])
            if not own.size:
                continue
            white = fit.whitener((1, 2)) @ motion[m:, own]
            limits = self._position_sigma[own] ** 2 * chdtri(len(white), STILL_PROBABILITY)
            resting = own[np.sum(white**2, axis=0) <= limits]
            motion[m:, resting] = 0.0  # see STILL_PROBABILITY
        tau, cov_tau = np.zeros((m, n)), np.empty((n, m, m))
        for k, torque in enumerate(torques):
            cov_tau[k] = torque.covariance((0,), self._torque_sigma[k], m)
            if torque.fit is not None:
                tau[:, k] = torque.values[:, 0]
        sigmas, motion = self._position_sigma, motion.reshape(len(MOTION), m, n)
        if self._coulomb_nm.any():
            ways = self._coulomb_nm * doubt(motion[1], self._speed_rad_s)
            cov_tau += np.einsum("win,wjn->nij", ways, ways)
        if self._cov_model.any():
            cov_tau += self._cov_model
        orders = [
            tuple(order - 1 for order in self._orders) if k in self.speeds.own else self._orders
            for k in range(n)
        ]
        return _Arm(
            motion=motion,
            walk_rad2=self.speeds.added(motion, fits, window.start_ns, window.stop_ns),
            tau_nm=tau,
            cov_joint=np.stack(
                [fit.covariance(*own) for fit, *own in zip(fits, orders, sigmas, strict=True)]
            ),
            cov_tau=cov_tau,
            tau_products_nm2=products,
            has_joint=np.array([torque.fit is not None for torque in torques]),
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
        *,
        gated: bool,
    ) -> tuple[FloatArray, FloatArray, bool, FloatArray]:
        """Return stacked derivatives at the nodes (len(orders) m, 3), their covariance, usable.

        And the mean products (L,) of the three axes; zero where they do not tell of the noise.
        """
        m, found, products = self._nodes, NO_FIT, np.zeros(len(LAGS))
        if not channel.missing:
            subject, spike, inconsistent = faults
            half_s = (window.stop_ns - window.start_ns) * 0.5e-9
            offsets_ns = _offsets(channel, (window.start_ns + window.stop_ns) // 2)
            high = m - 1 + EXTRA_DEGREE
            enough = len(channel.t_ns) > high + 1
            instants = Instants(offsets_ns, half_s, m, high if enough else m - 1)
            (found,) = instants.fitted(
                channel.values, np.array([sigma if gated else np.inf]), m - 1, orders, width=3
            )
            if self._is_doubtful(found.removed, len(channel.t_ns)):
                self._note(found.removed, inconsistent, subject, window)
                found = NO_FIT
            self._note(found.removed, spike, subject, window)
            counts = gated and _counts(len(channel.t_ns) / self._imu_samples)
            if enough and counts and found.fit is not None and not found.removed:
                products = instants.products(channel.values, self._imu_samples).mean(axis=1)
        rows = m * len(orders)
        values = np.zeros((rows, 3)) if found.fit is None else found.values
        return values, found.covariance(orders, sigma, rows), found.fit is not None, products

    @staticmethod
    def _is_doubtful(removed: int, samples: int) -> bool:
        return removed > max(MIN_SPIKES, SPIKE_RATIO * samples)

    def _note(self, removed: int, fault: Fault, subject: str, window: Window) -> None:
        self.outliers += removed
        if removed:
            text = f"{removed} samples off the window's polynomial"
            self._found.append(Finding(window.stop_ns, fault, subject, text))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Arm:
    """What a block holds of the joints; see `Block`."""

    motion: FloatArray  # (3, m, n) positions, rates and accelerations
    walk_rad2: FloatArray
    tau_nm: FloatArray
    cov_joint: FloatArray
    cov_tau: FloatArray
    tau_products_nm2: FloatArray
    has_joint: NDArray[np.bool_]


def _no_arm(m: int, size: int) -> _Arm:
    return _Arm(
        motion=np.zeros((len(MOTION), m, 0)),
        tau_nm=np.zeros((m, 0)),
        cov_joint=np.zeros((0, size, size)),
        cov_tau=np.zeros((0, m, m)),
        tau_products_nm2=np.zeros((len(LAGS), 0)),
        has_joint=np.zeros(0, np.bool_),
        walk_rad2=np.zeros(0),
    )


def _counts(fill: float) -> bool:
    """Return whether a window with this share of its samples tells of their noise."""
    return 1.0 - LACKING_RATIO <= fill <= 1.0 + SURPLUS_RATIO


def _offsets(channel: ChannelWindow, centre_ns: int) -> bytes:
    return (channel.t_ns - centre_ns).tobytes()


def _turn(angle_rad: FloatArray) -> FloatArray:
    """Return the quaternions (..., 4) xyzw of rotation vectors (..., 3)."""
    half = 0.5 * np.linalg.norm(angle_rad, axis=-1, keepdims=True)
    return np.concatenate([0.5 * np.sinc(half / np.pi) * angle_rad, np.cos(half)], axis=-1)


def build_conditioner(config: Config, model: RobotModel) -> Conditioner:
    """Build the conditioner of a configuration for its robot."""
    return Conditioner(config, joint_order(config, model))
