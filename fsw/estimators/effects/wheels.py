"""Reaction wheels: what is in doubt of each, what they report, and the momentum they carry.

A wheel k turns with the measured speed relative to the base: h_k = J_k speed_k, see `carried`.

A wheel may report less often than once a window, so no polynomial is fitted (except for a body
without joints, see `WheelMotion.along`). The torque on the rotor is modelled as a random walk of
known density. Momentum and torque at the nodes are estimated from the samples of this window and
the newest before it, as a Gaussian process: the optimal smoother of that random walk. The
covariance includes the uncertainty between slow samples and after the last one. Source: Rasmussen,
Williams, Gaussian Processes for Machine Learning (2006), sec. 2.2, 5.4.2 (leave-one-out residuals).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri, dtrtrs

from fsw.config import Config
from fsw.config.wheels import WheelConfig
from fsw.estimators.conditioning.window_fit import Instants, Wanted, fit_windows
from fsw.estimators.effects.carried import Carrier
from fsw.estimators.effects.device import Device, Driven, Part, Samples
from fsw.estimators.effects.on_base import Costly, OnBase
from fsw.estimators.model.inertia import about_com
from fsw.estimators.model.state_group import StateGroup, per_part
from fsw.messages import ChannelWindow, FloatArray, IntArray, Window, false_alarms
from fsw.messages.findings import Fault, Finding

BEFORE_PERIODS = 4.0  # report periods before the window whose samples are used too
SILENT_PERIODS = 5.0  # without a sample for longer, the momentum counts as unknown
MOST_SAMPLES = 48  # of momentum or of torque; more are averaged in groups
GATE_SIGMAS = false_alarms.sigmas("sample", sides=2)  # of white noise
LEAST_PER_NODE = 3  # samples; with fewer no polynomial is fitted
SPIKE_RATIO, MIN_SPIKES = 0.05, 3
VAGUE = 1e3  # noise sigmas by which the momentum before the first sample is uncertain

SCALE = StateGroup(  # relative error of each wheel's axial inertia
    name="wheel_scale",
    effect="inertia of wheels",
    unit="",
    key="wheels[].inertia_sigma_ratio",
    prior=per_part("wheels", "inertia_sigma_ratio"),
    is_calibration=True,
    mistake="axial inertia of wheels",
)
DELAY = StateGroup(  # true delay minus the configured one
    name="wheel_delay",
    effect="delay of wheels",
    unit="s",
    key="wheels[].delay_sigma_s",
    prior=per_part("wheels", "delay_sigma_s"),
    is_calibration=True,
)


def _speeding_up(own: WheelConfig, t_s: FloatArray, _window_s: float) -> FloatArray:
    gained = 0.1 * own.torque_limit_nm * t_s / own.inertia_kg_m2
    return np.stack([gained, np.full(len(t_s), np.nan)], axis=1)


def _at_rest(
    own: WheelConfig, _i: int, t_ns: IntArray, _span_ns: tuple[int, int], _driven: Driven
) -> Samples:
    still = np.zeros(len(t_ns))
    return t_ns, np.stack([still, np.where(own.torque == "none", np.nan, still)], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """Momentum and torque of one wheel at the m nodes."""

    h_nms: FloatArray  # (m,)
    hd_nm: FloatArray  # (m,)
    covariance: FloatArray  # (2 m, 2 m) of both
    removed: int  # outliers left out


@dataclass(frozen=True, slots=True, eq=False)
class _Samples:
    """Readings of momentum (order 0) or torque (order 1)."""

    t_s: FloatArray
    values: FloatArray
    order: IntArray
    sigma: FloatArray
    apart_s: FloatArray  # a group's mean varies like that of the instants t - apart_s, t + apart_s

    def without(self, row: int) -> _Samples:
        keep = np.arange(len(self.t_s)) != row
        columns = (self.t_s, self.values, self.order, self.sigma, self.apart_s)
        return _Samples(*(column[keep] for column in columns))

    def sides_s(self) -> tuple[FloatArray, ...]:
        """Return one or two arrays of instants; each sample is the mean at its instants."""
        return (
            (self.t_s - self.apart_s, self.t_s + self.apart_s)
            if self.apart_s.any()
            else (self.t_s,)
        )


class WheelsMotion:
    """Conditioning of all wheels, as `Follower`."""

    def __init__(self, config: Config) -> None:
        self._wheels = [WheelMotion(wheel) for wheel in config.wheels]
        self._has_joints = len(config.joints) > 0

    def at(self, window: Window, t_ns: IntArray) -> Part:
        """Return the wheels' part of a block; its fields are None if a momentum is unknown."""
        found: list[Turn | None] = []
        findings = []
        for wheel, channel in zip(self._wheels, window.of("wheels"), strict=True):
            turn = None
            if not self._has_joints:  # the body's motion is known by its gyro alone
                half_s, m = (window.stop_ns - window.start_ns) * 0.5e-9, len(t_ns)
                offsets_ns = channel.t_ns - (window.start_ns + window.stop_ns) // 2
                turn = wheel.along(channel, Instants(offsets_ns.tobytes(), half_s, m, m - 1))
            turn = turn or wheel.at(channel, window.start_ns, t_ns)
            found.append(turn)
            if turn is None and not channel.stale:
                text = "its samples do not agree with one another"
                fault = Fault.WHEEL_INCONSISTENT
                findings.append(Finding(window.stop_ns, fault, wheel.name, text))
        known, fields = [turn for turn in found if turn is not None], None
        if len(known) == len(found):
            fields = {
                "carried_nms": np.stack([turn.h_nms for turn in known], axis=1),
                "carried_nm": np.stack([turn.hd_nm for turn in known], axis=1),
                "cov_carried": np.stack([turn.covariance for turn in known]),
            }
        removed = sum(turn.removed for turn in known)
        return Part(fields=fields, findings=findings, removed=removed)


class WheelMotion:
    """Conditioning of one wheel; keeps the newest samples of earlier windows."""

    def __init__(self, config: WheelConfig) -> None:
        self.name = config.name
        self._config = config
        self._before_ns = round(BEFORE_PERIODS / config.rate_hz * 1e9)
        self._silent_ns = round(SILENT_PERIODS / config.rate_hz * 1e9)
        self._t_ns = np.empty(0, np.int64)
        self._values = np.empty((0, 2))

    def at(self, channel: ChannelWindow, start_ns: int, t_ns: IntArray) -> Turn | None:
        """Return the wheel at the nodes t_ns (m,) of the window that begins at start_ns.

        None: the wheel is silent, or its samples do not agree with one another.
        """
        times, values = (
            np.concatenate([self._t_ns, channel.t_ns]),
            np.concatenate([self._values, channel.values]),
        )
        keep = times >= start_ns - self._before_ns
        self._t_ns, self._values = times[keep], values[keep]
        if not len(self._t_ns):  # an older sample may still be fresh enough
            self._t_ns, self._values = times[-1:], values[-1:]
        if not len(self._t_ns) or int(t_ns[-1]) - int(self._t_ns[-1]) > self._silent_ns:
            return None
        return self._estimated(t_ns)

    def along(self, channel: ChannelWindow, instants: Instants) -> Turn | None:
        """Return the wheel at the nodes of a window by the same polynomial fit as the gyro's.

        The fit smooths a motor's switching and the body's answer alike, so the two cancel in their
        balance; therefore no sample is removed as an outlier. None: too few samples.
        """
        J, orders = self._config.inertia_kg_m2, (0, 1)
        if len(channel.t_ns) < LEAST_PER_NODE * instants.nodes:
            return None
        values, sigma = J * channel.values[:, :1], J * self._config.speed_noise_rad_s
        wanted = Wanted(instants, values, np.array([np.inf]), instants.degree, orders)
        (found,) = fit_windows([wanted])[0].channels
        if found.fit is None:
            return None
        h, hd = found.values.reshape(2, -1)
        return Turn(h, hd, found.covariance(orders, sigma, 2 * len(h)), found.removed)

    def _estimated(self, t_ns: IntArray) -> Turn | None:
        origin_ns = min(int(t_ns[0]), int(self._t_ns[0]))
        J = self._config.inertia_kg_m2
        t_s = np.asarray((self._t_ns - origin_ns) * 1e-9, np.float64)
        sigma = J * self._config.speed_noise_rad_s
        parts = [_thinned(t_s, J * self._values[:, 0], 0, sigma)]
        known = np.isfinite(self._values[:, 1])
        if known.any() and self._config.torque_noise_nm is not None:
            torque = self._values[known, 1]
            parts.append(_thinned(t_s[known], torque, 1, self._config.torque_noise_nm))
        samples = _Samples(*(np.concatenate(column) for column in zip(*parts, strict=True)))
        middle = float(np.median(parts[0][1]))
        samples.values[samples.order == 0] -= middle
        least = 1 + len(samples.t_s) - max(MIN_SPIKES, int(SPIKE_RATIO * len(samples.t_s)))
        removed = 0
        while True:
            root = self._root(samples, sigma)
            inverse = _inverse(root)
            doubt = np.abs(inverse @ samples.values) / np.sqrt(np.diag(inverse))
            worst = int(np.argmax(doubt))
            if doubt[worst] <= GATE_SIGMAS:
                break
            samples, removed = samples.without(worst), removed + 1
            if len(samples.t_s) < max(least, 1):
                return None
        nodes = np.tile((t_ns - origin_ns) * 1e-9, 2)
        orders = np.repeat([0, 1], len(t_ns))
        prior = self._prior(samples, sigma)
        sides = samples.sides_s()
        across = _mean([self._kernel(nodes, orders, u, samples.order, prior) for u in sides])
        # mean and covariance by the root: the inverse would lose digits of a vague momentum
        whitened = dtrtrs(root, across.T, lower=1)[0]
        covariance = self._kernel(nodes, orders, nodes, orders, prior) - whitened.T @ whitened
        mean = whitened.T @ dtrtrs(root, samples.values, lower=1)[0].ravel()
        h, hd = mean[: len(t_ns)] + middle, mean[len(t_ns) :]
        return Turn(h, hd, 0.5 * (covariance + covariance.T), removed)

    def _prior(self, samples: _Samples, sigma: float) -> tuple[float, float]:
        """Return the variances of momentum and torque at the time origin."""
        size = np.abs(samples.values[samples.order == 0]).max(initial=0.0)
        return (size + VAGUE * sigma) ** 2, (2.0 * self._config.torque_limit_nm) ** 2

    def _root(self, samples: _Samples, sigma: float) -> FloatArray:
        """Return the lower Cholesky factor of the samples' covariance; else raise LinAlgError."""
        prior = self._prior(samples, sigma)
        sides, order = samples.sides_s(), samples.order
        S = _mean([self._kernel(t, order, u, order, prior) for t in sides for u in sides])
        S[np.diag_indices_from(S)] += samples.sigma**2
        torque = order == 1
        S += self._config.torque_offset_sigma_nm**2 * np.outer(torque, torque)
        root, info = dpotrf(S, lower=1)
        if info:
            raise np.linalg.LinAlgError(f"samples of {self.name}")
        lower: FloatArray = root
        return lower

    def _kernel(
        self,
        t_s: FloatArray,
        order: IntArray,
        u_s: FloatArray,
        other: IntArray,
        prior: tuple[float, float],
    ) -> FloatArray:
        """Return cov (k, l) of momentum (order 0) or torque (1) at times t and u from the origin.

        Torque T = T0 + random walk of density q, momentum h = h0 + integral of T.
        """
        q, (P_h, P_T) = self._config.walk_nm_sqrt_s**2, prior
        t, u = t_s[:, None], u_s[None, :]
        low = np.minimum(t, u)
        both = P_h + t * u * P_T + q * low**2 * (0.5 * np.maximum(t, u) - low / 6.0)
        by_u = t * P_T + q * np.where(u >= t, 0.5 * t**2, u * t - 0.5 * u**2)
        by_t = u * P_T + q * np.where(t >= u, 0.5 * u**2, u * t - 0.5 * t**2)
        a, b = order[:, None] == 1, other[None, :] == 1
        of_momentum = np.where(b, by_u, both)
        whole: FloatArray = np.where(a, np.where(b, P_T + q * low, by_t), of_momentum)
        return whole


def _inverse(root: FloatArray) -> FloatArray:
    """Return the inverse of root @ root.T."""
    inverse = np.tril(dpotri(root, lower=1)[0])
    whole: FloatArray = inverse + np.tril(inverse, -1).T
    return whole


def _mean(parts: list[FloatArray]) -> FloatArray:
    total: FloatArray = parts[0] if len(parts) == 1 else sum(parts[1:], parts[0]) / len(parts)
    return total


def _thinned(
    t_s: FloatArray, values: FloatArray, order: int, sigma: float
) -> tuple[FloatArray, FloatArray, IntArray, FloatArray, FloatArray]:
    """Return the columns of `_Samples` with at most MOST_SAMPLES rows: means of groups.

    The mean of m readings of torque (a random walk), s apart, has the variance of the mean of two
    readings s (m^2 - 1) / (3 m) before and after the middle. For momentum, which is smooth, the two
    are s sqrt((m^2 - 1) / 12) before and after it.
    """
    size = -(-len(t_s) // MOST_SAMPLES)
    heads = np.arange(0, len(t_s), size)
    counts = np.diff(np.append(heads, len(t_s)))
    means = [np.add.reduceat(part, heads) / counts for part in (t_s, values)]
    length_s = t_s[heads + counts - 1] - t_s[heads]
    step_s = length_s / np.maximum(counts - 1, 1)
    squares: IntArray = counts**2 - 1
    steps: FloatArray = squares / (3 * counts) if order else np.sqrt(squares / 12)
    apart_s = step_s * steps
    return means[0], means[1], np.full(len(heads), order), sigma / np.sqrt(counts), apart_s


WHEELS = Device(
    section="wheels",
    groups=(SCALE, DELAY),
    gentle=_speeding_up,
    along=_at_rest,
    follow=WheelsMotion,
)


def carrier(config: Config, places: Mapping[str, slice]) -> Carrier:
    """Return the wheels of a configuration, for a state whose groups are at `places`."""
    axes = np.array([wheel.axis_B for wheel in config.wheels]).reshape(-1, 3).T
    states = places.get(SCALE.name), places.get(DELAY.name)
    speed = np.array([own.inertia_kg_m2 * own.speed_limit_rad_s for own in config.wheels])
    torque = np.array([own.torque_limit_nm for own in config.wheels])
    return Carrier(axes, *states, config.estimator.window_s, speed, torque)


def _faults(config: Config, base: FloatArray) -> Iterator[str]:
    """Yield a line for each rotor with at least the inertia of the base (10,) about its axis."""
    if config.base.motion != "free" or base[0] <= 0.0:
        return
    central = about_com(base)
    for i, wheel in enumerate(config.wheels):
        axis = np.array(wheel.axis_B)
        most = float(axis @ central @ axis)
        if wheel.inertia_kg_m2 >= most:
            yield (
                f"wheels.{i}.inertia_kg_m2: {wheel.inertia_kg_m2:g} ({wheel.name}); locked it "
                f"belongs to base; must be below its inertia about the wheel's axis, {most:.4g}"
            )


def _left_out(config: Config, _fired_s: float) -> list[Costly]:
    limits = [wheel.torque_limit_nm for wheel in config.wheels]
    words = f"wheels that hold the base, up to {max(limits, default=0.0):.3g} N m each"
    return [((), words)] * bool(limits)


def _words(config: Config) -> list[str]:
    """Return a line for each wheel, and a line on what the model does not contain."""
    lines = []
    for wheel in config.wheels:
        axis = " ".join(f"{x:.4g}" for x in wheel.axis_B)
        most = wheel.inertia_kg_m2 * wheel.speed_limit_rad_s
        torque = "speed" if wheel.torque == "none" else "speed and motor torque"
        lines.append(
            f"{wheel.name}: axis [{axis}], {wheel.inertia_kg_m2:.4g} kg m^2 "
            f"+- {wheel.inertia_sigma_ratio:.1%}, {torque} at {wheel.rate_hz:g} Hz, at most "
            f"{most:.4g} N m s and {wheel.torque_limit_nm:.4g} N m"
        )
    return [*lines, "mass and locked inertia of every wheel belong to base; imbalance is noise"]


ON_BASE = OnBase(
    section="wheels",
    absent="reaction wheels",
    is_possible=lambda config: config.base.motion != "clamped",
    words=_words,
    faults=_faults,
    left_out=_left_out,
    unplanned=lambda _: "wheels: counted as if they stood still relative to the base",
)
