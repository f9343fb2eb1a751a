"""The arm's motion and torques at the nodes of a window, from its joints' samples."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from fsw.config import Config
from fsw.estimators.conditioning.polynomial import EXTRA_DEGREE
from fsw.estimators.conditioning.reversal import doubt, step
from fsw.estimators.conditioning.speed_motion import SpeedMotion
from fsw.estimators.conditioning.standstill import Standstills
from fsw.estimators.conditioning.truncation import omitted
from fsw.estimators.conditioning.window_fit import NO_FIT, ChannelFit, Fitted, Instants, Wanted
from fsw.estimators.model.building import torque_model_covariance, torque_samples
from fsw.estimators.noise.found import LAGS
from fsw.messages import FloatArray, Window
from fsw.messages.findings import Fault

STILL_PROBABILITY = 1e-6  # of calling a joint at rest a moving one, per window
SPIKE_RATIO = 0.05  # of a window's samples; more outliers mean that the channel is not to be used
MIN_SPIKES = 3
SURPLUS_RATIO = 0.01  # share of surplus samples above which a window does not count for the noise
LACKING_RATIO = 0.25  # share of missing samples, likewise
LEAST_STEP = 0.05  # of a sample's noise: blocks where friction reverses by more do not count for it
MOTION = (0, 1, 2)  # derivatives of a joint's position
ORDERS = (1, 2, 0)  # of the covariance of a joint's motion
OF_SPEED = (-1, 0, 1)  # the same derivatives, counted from its speed
SPEED_EXTRA_DEGREE = 1  # of a speed's polynomial over a torque's: its first derivative is used


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Arm:
    """The joints' part of a block; see `Block`."""

    motion: FloatArray  # (3, m, n) positions, rates and accelerations
    walk_rad2: FloatArray
    tau_nm: FloatArray
    cov_joint: FloatArray
    cov_tau: FloatArray
    tau_products_nm2: FloatArray
    has_joint: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class ArmWanted:
    """The polynomial fits that the joints of a window need."""

    wanted: Sequence[Wanted]
    own: Sequence[list[int]]  # joints whose samples each fit contains
    is_motion: Sequence[bool]  # whether a fit is of positions or speeds; else of torques
    counts: Sequence[int]  # samples of each joint
    gated: bool


Removed = list[tuple[int, Fault, int]]  # joint, fault, number of samples left out


class ArmConditioner:
    """Fits the joints' samples of each window and makes the joints' part of its block.

    Attributes
    ----------
    speeds : integrates speeds to angles, from window to window
    """

    def __init__(self, config: Config, order: tuple[int, ...]) -> None:
        self._nodes = config.estimator.nodes
        self._min_fill = config.estimator.min_fill_ratio
        self._order = order
        joints = tuple(config.joints[k] for k in order)
        rates_hz = {bus.name: bus.rate_hz for bus in config.buses}
        self.speeds = SpeedMotion(joints, self._nodes, rates_hz)
        self._position_sigma = np.array(
            [joint.speed_noise_rad_s or joint.position_noise_rad for joint in joints]
        )
        self._stamp_s = np.array([joint.stamp_sigma_s for joint in joints])
        fastest = self._stamp_s * [joint.speed_limit_rad_s for joint in joints]
        self._position_gate = np.hypot(self._position_sigma, fastest)
        self._torque_sigma = np.array([joint.torque_noise_nm for joint in joints])
        self._coulomb_nm = np.array([joint.friction_coulomb_sigma_nm for joint in joints])
        self._speed_rad_s = np.array([joint.friction_speed_rad_s for joint in joints])
        self._standstills = Standstills(self._position_sigma)
        self._samples = torque_samples(config, order)[: len(order)]
        self._cov_model = torque_model_covariance(config, order)[: len(order)]
        # reversing friction deviates from the polynomial: up to 3 sigma of it is not an outlier
        left_out = np.array([joint.torque_model_sigma_nm for joint in joints])
        self._torque_gate = np.hypot(np.hypot(self._torque_sigma, 0.5 * self._coulomb_nm), left_out)

    def wanted(self, window: Window, *, gated: bool) -> ArmWanted | None:
        """Return the fits that a window needs; None where a joint's samples are missing.

        If not `gated`, torques are not polynomials, and none of their samples counts as an outlier.
        """
        channels = [window.joints[k] for k in self._order]
        if any(channel.missing for channel in channels):
            return None
        centre_ns = (window.start_ns + window.stop_ns) // 2
        half_s = (window.stop_ns - window.start_ns) * 0.5e-9
        latched: dict[bytes, list[int]] = {}  # joints by the instants of their samples
        for k, channel in enumerate(channels):
            latched.setdefault((channel.t_ns - centre_ns).tobytes(), []).append(k)
        high, low = self._nodes - 1 + EXTRA_DEGREE, self._nodes - 1
        found: list[tuple[Wanted, list[int], bool]] = []
        for offsets_ns, joints in latched.items():
            instants = Instants(offsets_ns, half_s, self._nodes, high)
            values = np.concatenate([channels[k].values for k in joints], axis=1)
            for is_speed, degree, orders in (
                (False, high, MOTION),
                (True, low + SPEED_EXTRA_DEGREE, OF_SPEED),
            ):
                own = [k for k in joints if (k in self.speeds.own) == is_speed]
                if own:
                    part = values[:, [2 * joints.index(k) for k in own]]
                    sigmas = self._position_gate[own]
                    found.append((Wanted(instants, part, sigmas, degree, orders), own, True))
            force = Wanted(
                instants,
                values[:, 1::2],
                self._torque_gate[joints] if gated else np.full(len(joints), np.inf),
                low,
                (0,),
                min_fill=self._min_fill,
                samples=int(self._samples[joints[0]]),
            )
            found.append((force, joints, False))
        counts = [len(channel.t_ns) for channel in channels]
        if not found:
            return ArmWanted((), (), (), counts, gated)
        wanted, owners, motions = zip(*found, strict=True)
        return ArmWanted(wanted, owners, motions, counts, gated)

    def made(
        self, asked: ArmWanted, fitted: Sequence[Fitted], start_ns: int, stop_ns: int
    ) -> tuple[Arm | None, Removed]:
        """Return the arm from its fits, and the samples left out; None: a position is unknown."""
        n, removed = len(asked.counts), list[tuple[int, Fault, int]]()
        readings = np.ones(n)  # samples that repeat one torque reading
        repeats = np.ones(n)  # samples that share one rounding error of an angle
        positions, torques, products = [NO_FIT] * n, [NO_FIT] * n, np.zeros((len(LAGS), n))
        for found, own, is_motion, wanted in zip(
            fitted, asked.own, asked.is_motion, asked.wanted, strict=True
        ):
            for k, channel in zip(own, found.channels, strict=True):
                (positions if is_motion else torques)[k] = channel
            if is_motion:
                repeats[own] = [held_samples(column) for column in wanted.values.T]
            else:
                products[:, own] = found.products
                is_held = (wanted.values == wanted.values[:1]).all(axis=0)
                readings[own] = np.where(is_held, max(len(wanted.values), 1), 1.0)
        for k, count in enumerate(asked.counts):
            removed.append((k, Fault.ENCODER_SPIKE, positions[k].removed))
            if positions[k].fit is None:
                return None, removed
            if is_doubtful(torques[k].removed, count):
                removed.append((k, Fault.TORQUE_INCONSISTENT, torques[k].removed))
                torques[k] = NO_FIT
            removed.append((k, Fault.TORQUE_SPIKE, torques[k].removed))
            tells = asked.gated and tells_of_noise(count / self._samples[k])
            if torques[k].fit is None or torques[k].removed or not tells:
                products[:, k] = 0.0
        held = repeats, readings
        return self._joined(positions, torques, products, held, (start_ns, stop_ns)), removed

    def _joined(
        self,
        positions: list[ChannelFit],
        torques: list[ChannelFit],
        products: FloatArray,
        held: tuple[FloatArray, FloatArray],
        bounds_ns: tuple[int, int],
    ) -> Arm:
        m, n, half_s = self._nodes, len(positions), (bounds_ns[1] - bounds_ns[0]) * 0.5e-9
        repeats, readings = held
        if n == 0:
            return _no_arm(m)
        fits = [position.fit for position in positions if position.fit is not None]
        motion = np.concatenate([position.values for position in positions], axis=1)
        sigmas, of_speed = self._position_sigma, self.speeds.own
        # an error of the time is one of the position by as much as the joint moves meanwhile
        stamps = self._stamp_s * np.sqrt(np.mean(motion[m : 2 * m] ** 2, axis=0))
        moving = np.hypot(sigmas * np.sqrt(repeats), stamps)
        is_resting = np.zeros(n, np.bool_)
        cov_joint = np.empty((n, len(ORDERS) * m, len(ORDERS) * m))
        for fit in dict.fromkeys(fits):
            own = np.array([k for k in range(n) if fits[k] is fit])
            is_speed = own[0] in of_speed  # joints with and without positions share no fit
            orders = tuple(order - is_speed for order in ORDERS)
            cov_joint[own] = moving[own, None, None] ** 2 * fit.covariance(orders, 1.0)
            of_fit = motion.reshape(len(MOTION), m, n)[list(ORDERS)][:, :, own]
            degree = fit.fit.degree + is_speed
            # a coefficient of the position is about that of the speed, integrated
            scale = half_s / (2 * degree - 1) if is_speed else 1.0
            sigma, left = scale * moving[own], scale**2 * np.array([positions[k].left for k in own])
            cov_joint[own] += omitted(of_fit, degree, half_s, sigma, fit.fit.samples, left.T)
            if is_speed:
                continue
            white = fit.whitener((1, 2)) @ motion[m:, own]
            limits = sigmas[own] ** 2 * chdtri(len(white), STILL_PROBABILITY)
            resting = own[np.sum(white**2, axis=0) <= limits]
            is_resting[resting] = True
            motion[m:, resting] = 0.0  # a joint at rest has no rate and acceleration
            motion[:m, resting] = motion[:m, resting].mean(axis=0)
        tau, cov_tau = np.zeros((m, n)), np.empty((n, m, m))
        for k, torque in enumerate(torques):
            if torque.fit is not None:
                tau[:, k] = torque.values[:, 0]
        for found in {id(torque.fit): torque for torque in torques}.values():
            own = np.array([k for k in range(n) if torques[k].fit is found.fit])
            alike = np.where(is_resting[own], readings[own], 1.0)
            variances = self._torque_sigma[own] ** 2 * alike
            unit = 1.0 if found.fit is None else variances[:, None, None]
            cov_tau[own] = unit * found.covariance((0,), 1.0, m)
        motion = motion.reshape(len(MOTION), m, n)
        if self._coulomb_nm.any():
            lasting = self._standstills.factor(motion[0].mean(axis=0), is_resting)
            ways = lasting * self._coulomb_nm * doubt(motion[1], self._speed_rad_s)
            cov_tau += np.einsum("win,wjn->nij", ways, ways)
            steps = self._coulomb_nm * step(motion[1], self._speed_rad_s)
            products = np.where(steps > LEAST_STEP * self._torque_sigma, 0.0, products)
        if self._cov_model.any():
            cov_tau += self._cov_model
        return Arm(
            motion=motion,
            walk_rad2=self.speeds.added(motion, fits, *bounds_ns),
            tau_nm=tau,
            cov_joint=cov_joint,
            cov_tau=cov_tau,
            tau_products_nm2=products,
            has_joint=np.array([torque.fit is not None for torque in torques]),
        )


def held_samples(values: FloatArray) -> float:
    """Return how many samples (k,) share one rounding error, on average over the samples.

    All samples of a run at one count share theirs, unless the angle passes through the count: then
    the errors sweep the whole step, and their mean is that of independent ones or nearer to zero.
    """
    steps = np.diff(values)
    ends = np.flatnonzero(steps)
    if len(ends) == len(steps):
        return 1.0
    runs = np.diff(np.concatenate([[-1], ends, [len(steps)]])).astype(np.float64)
    signs = np.sign(steps[ends])
    passed = np.concatenate([[False], signs[1:] == signs[:-1], [False]])[: len(runs)]
    return float(np.sum(np.where(passed, runs, runs**2)) / len(values))


def is_doubtful(removed: int, samples: int) -> bool:
    """Return whether a channel has too many outliers to be used."""
    return removed > max(MIN_SPIKES, SPIKE_RATIO * samples)


def tells_of_noise(fill: float) -> bool:
    """Return whether a window with this share of its samples counts for the noise."""
    return 1.0 - LACKING_RATIO <= fill <= 1.0 + SURPLUS_RATIO


def _no_arm(m: int) -> Arm:
    size = len(ORDERS) * m
    return Arm(
        motion=np.zeros((len(MOTION), m, 0)),
        tau_nm=np.zeros((m, 0)),
        cov_joint=np.zeros((0, size, size)),
        cov_tau=np.zeros((0, m, m)),
        tau_products_nm2=np.zeros((len(LAGS), 0)),
        has_joint=np.zeros(0, np.bool_),
        walk_rad2=np.zeros(0),
    )
