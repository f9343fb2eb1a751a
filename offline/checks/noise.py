"""Noise of recorded channels, and windows that are too long for the motion.

Noise is judged by high-order divided differences of neighbouring samples. They contain no motion
(it is smooth over a few samples) and no model, so that a window's polynomial that does not follow
the motion is not mistaken for a noisy sensor. Such a polynomial shows in another way: its residual
is larger than the noise, and it shrinks many times over if the window is halved. The residual of
coloured noise, which differences underestimate, hardly shrinks. A torque's noise is that of the
sensor and what no model explains; where it is coloured, the estimate finds and counts it.
Source of the differences: Gasser, Sroka, Jennen-Steinmetz, Biometrika 73 (1986) 625.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre

from fsw.checks.windows import window_faults
from fsw.config import Config
from fsw.estimators.conditioning.polynomial import EXTRA_DEGREE
from fsw.messages import ChannelWindow, FloatArray, IntArray, Window
from offline.checks.comparison import Comparison

EXACT_RAD = 1e-11  # noise of an angle below this is of no encoder (36 bits)
OTHER_UNIT = 30.0  # declared noise too large by this ratio: a wrong unit gives 57 or 60
NOISIER = 1.4  # ratio of found to declared noise above which the configuration is wrong
CHANCE = 6.0  # over the root of the number of samples: 3 standard errors of noise by differences
NOTED = 1.2  # above this ratio a note says so
CLEANER = 2.0  # ratio of declared to found noise above which a note says so
ORDER = 6  # of the differences
TRIMMED, WITHIN = 0.5, 0.1426  # share of the largest differences left out; variance of the others
WINDOWS = 100  # most windows from which the noise is found, spread over the recording
MOVED = 20.0  # range of a window over the noise above which a channel moves
SHARE = 0.1  # of the largest range: a window with less rests; of all windows: fewer show little
FEW = 3  # windows; fewer that move may be a shock
REST = 1e-3  # range of an angle [rad or m] of a joint that is held, which sways with the others
COLOURED = 1.4  # ratio of a polynomial's residual to the noise by differences; above: judged
SHRINKS = 0.25  # ratio of the excess variance in half a window, below which it is misfit
MISFIT = 2.0  # accepted ratio of misfit to noise, found or declared
SHORTEST = 6  # most halvings of a window


Piece = tuple[IntArray, FloatArray]  # times (k,) [ns] and finite readings (k,) in one window


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Noise:
    """Noise of one channel, and the residual of polynomials of a window's length."""

    sigma: float  # 1 sigma of a sample; 0: the readings do not change, or there are too few
    coloured: bool = False  # whether differences show far less of it than polynomials
    misfit: float = 0.0  # 1 sigma of the residual that is not noise; 0: polynomials follow
    moves: bool = True  # False: at rest in most windows, where a sensor may have less noise
    pieces: Sequence[Piece] = ()  # windows that were judged


def noise_findings(config: Config, windows: Sequence[Window]) -> list[Comparison]:
    """Return a finding for the noise of each channel, and one if windows are too long.

    `windows` is not empty.
    """
    places = np.linspace(0, len(windows) - 1, min(WINDOWS, len(windows))).round().astype(int)
    judged = [windows[k] for k in places]
    degree = config.estimator.nodes - 1 + EXTRA_DEGREE
    found, misfits = [], dict[str, tuple[Noise, float]]()
    for channel in _channels(config, judged):
        each = [
            motion_noise([_finite(own, column) for own in windows], degree, REST * channel.is_angle)
            for windows, column in channel.columns
        ]
        middle = sorted(each, key=lambda noise: noise.sigma)[len(each) // 2]
        chance = _chance([piece for noise in each for piece in noise.pieces])
        found.append(_noise_finding(channel, middle, 1.0 + chance))
        least = max(middle.sigma, channel.sigma / channel.scale)
        if middle.misfit > MISFIT * least:
            misfits[channel.key] = middle, least
    if misfits:
        found.append(_too_long(config, degree, misfits))
    return found


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Channel:
    """A declared noise, and the readings that show it."""

    key: str
    declared: float
    columns: list[tuple[list[ChannelWindow], int]]  # windows of a channel, and its column
    scale: float = 1.0  # the key's unit over a sample's sigma
    model: tuple[str, float] | None = None  # of a torque: key and 1 sigma of what no model explains
    is_angle: bool = False  # an encoder's, or the speed from it

    @property
    def sigma(self) -> float:
        """Return 1 sigma of a sample about the model, as declared, in the key's unit."""
        return float(np.hypot(self.declared, self.model[1] if self.model else 0.0))


def _channels(config: Config, windows: Sequence[Window]) -> list[_Channel]:
    """Return the channels whose noise a configuration declares."""
    found: list[_Channel] = []
    for k, joint in enumerate(config.joints):
        own = [window.joints[k] for window in windows]
        keys = {"position_noise_rad": (joint.position_noise_rad, 0)}
        if joint.speed_noise_rad_s is not None:
            keys = {"speed_noise_rad_s": (joint.speed_noise_rad_s, 0)}
        if joint.torque != "none":
            keys = {"torque_noise_nm": (joint.torque_noise_nm, 1)} | keys
        (model,) = joint.named({"torque_model_sigma_nm": joint.torque_model_sigma_nm}).items()
        for key, (declared, column) in joint.named(keys).items():
            channel = _Channel(
                key=f"joints.{k}.{key}",
                declared=declared,
                columns=[(own, column)],
                model=(f"joints.{k}.{model[0]}", model[1]) if column == 1 else None,
                is_angle=column == 0,
            )
            found.append(channel)
    for k, sensor in enumerate(config.wrench_sensors):
        own = [window.of("wrench_sensors")[k] for window in windows]
        for key, first in (("force_noise_n", 0), ("torque_noise_nm", 3)):
            axes, declared = [(own, first + axis) for axis in range(3)], float(getattr(sensor, key))
            place = f"wrench_sensors.{k}.{key}"
            found.append(_Channel(key=place, declared=declared, columns=axes))
    if not config.imu.present:
        return found
    for key, channels in (
        ("angle_random_walk_rad_sqrt_s", [window.gyro for window in windows]),
        ("velocity_random_walk_m_s_sqrt_s", [window.accelerometer for window in windows]),
    ):
        axes = [(channels, axis) for axis in range(3)]
        root, declared = config.imu.rate_hz**-0.5, float(getattr(config.imu, key))
        found.append(_Channel(key=f"imu.{key}", declared=declared, columns=axes, scale=root))
    return found


def motion_noise(windows: Sequence[Piece], degree: int, least: float) -> Noise:
    """Return the noise of a channel in the windows in which it moves; if few do, in all.

    Parameters
    ----------
    degree : of a window's polynomial; windows with too few samples for it are left out
    least : range below which a window is at rest
    """
    pieces = [(t, x) for t, x in windows if len(t) >= 2 * degree + 2]
    everywhere = difference_sigma(*pieces)
    if not everywhere:
        return Noise(sigma=0.0, moves=False)
    ranges = np.array([np.ptp(x) for _, x in pieces])
    largest = np.sort(ranges)[-min(FEW, len(ranges))]
    is_moving = ranges > max(MOVED * everywhere, SHARE * largest, least)
    count = np.count_nonzero(is_moving)
    is_shown = count >= min(FEW, len(pieces))
    judged = [own for own, one in zip(pieces, is_moving, strict=True) if one or not is_shown]
    moves = bool(is_shown and count >= SHARE * len(pieces))
    sigma = difference_sigma(*judged)
    whole, middle = _residual(judged, degree), _residual(judged, degree, 0.5)
    if abs(middle - sigma) < sigma * _chance(judged):  # it is noise, measured better
        sigma = middle
    if whole <= COLOURED * sigma:
        return Noise(sigma=sigma, moves=moves, pieces=judged)
    halves = [half for piece in judged for half in _halves(piece, degree)]
    excess, left = whole**2 - sigma**2, _residual(halves, degree) ** 2 - sigma**2
    if halves and left < SHRINKS * excess:
        return Noise(sigma=sigma, misfit=excess**0.5, moves=moves, pieces=judged)
    return Noise(sigma=whole, coloured=True, moves=moves, pieces=judged)


def _finite(channel: ChannelWindow, column: int) -> Piece:
    values = channel.values[:, column] if len(channel.t_ns) else np.empty(0)
    good = np.isfinite(values)
    good[1:] &= np.diff(channel.t_ns) > 0  # a clock that was set back gives a time twice
    return channel.t_ns[good], values[good]


def _halves(piece: Piece, degree: int) -> list[Piece]:
    """Return both halves of a window; empty if they have too few samples for the degree."""
    t_ns, x = piece
    half = len(x) // 2
    return [] if half < degree + 3 else [(t_ns[:half], x[:half]), (t_ns[half:], x[half:])]


def _residual(pieces: Sequence[Piece], degree: int, share: float = 0.75) -> float:
    """Return the quantile over windows, at `share`, of the residual of their polynomials."""
    return float(np.quantile([residual_sigma(*piece, degree) for piece in pieces] or [0.0], share))


def _chance(pieces: Sequence[Piece]) -> float:
    """Return three relative standard errors of the noise by differences."""
    return CHANCE / float(np.sqrt(max(1, sum(len(x) for _, x in pieces))))


def difference_sigma(*pieces: Piece) -> float:
    """Return 1 sigma of white noise on pieces of a smooth motion; 0: none, or too few samples.

    It is the root of the mean variance of the pieces: noise may grow with the speed.
    """
    return float(np.sqrt(np.mean([_difference_sigma(*own) ** 2 for own in pieces] or [0.0])))


def _difference_sigma(t_ns: IntArray, x: FloatArray) -> float:
    """Return 1 sigma on one piece, without the larger half of the differences: those at spikes."""
    squares = np.sort(_differences(t_ns, x) ** 2)
    kept = squares[: round((1.0 - TRIMMED) * len(squares))]
    if not kept.any():  # few samples, or coarse readings of a slow motion, which seldom change
        return float(np.sqrt(squares.mean())) if len(squares) else 0.0
    return float(np.sqrt(kept.mean() / WITHIN))


def _differences(t_ns: IntArray, x: FloatArray) -> FloatArray:
    """Return the divided differences of samples x (k,) at t (k,), (k - ORDER,), scaled to noise.

    Weights of a divided difference of order p are 1 / prod(t_k - t_j) over its p + 1 samples; they
    cancel every polynomial of a lower degree.
    """
    count = len(x) - ORDER
    if count < 1:
        return np.empty(0)
    at = np.arange(count)[:, None] + np.arange(ORDER + 1)
    t = (t_ns - t_ns[0]) / max(float(np.ptp(t_ns)), 1.0) * len(t_ns)
    gaps = t[at][:, :, None] - t[at][:, None, :] + np.eye(ORDER + 1)
    weights = 1.0 / gaps.prod(axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    return np.asarray(np.sum(weights * x[at], axis=1))


def residual_sigma(t_ns: IntArray, x: FloatArray, degree: int) -> float:
    """Return 1 sigma of samples x (k,) about their polynomial of a degree, k > degree + 1."""
    t = t_ns - t_ns[0]
    basis = legendre.legvander(2.0 * t / max(t[-1], 1) - 1.0, degree)
    _, squares, rank, _ = np.linalg.lstsq(basis, x, rcond=None)
    return float(np.sqrt(squares[0] / (len(t) - rank))) if squares.size else 0.0


def _noise_finding(channel: _Channel, noise: Noise, chance: float) -> Comparison:
    key, declared, found = channel.key, channel.declared, noise.sigma * channel.scale
    words = note = ""
    noisier = found > NOISIER * chance * channel.sigma
    if noisier and noise.coloured and channel.model is not None:
        return _outside_the_model(*channel.model, float(np.sqrt(found**2 - declared**2)))
    if noisier:
        words = f"the data are noisier: set {key} to {found:.3g}, or look for disturbances"
    elif found > NOTED * chance * channel.sigma:
        note = f"a little noisier than declared: set {key} to {found:.3g}"
    elif found == 0.0:
        words = "the readings do not change, or there are too few"
    elif channel.is_angle and not noise.moves and found < declared:
        note = "less than declared, as of a joint that hardly moves"
    elif channel.is_angle and found < EXACT_RAD:
        note = "without noise, as of a simulation"
    elif found < declared / OTHER_UNIT:
        unit = f"is {key} in another unit (degrees, hours)?"
        if channel.model is not None:
            note = f"the data are far cleaner, {found:.3g}: filtered torques, or {unit}"
        else:
            words = f"the data are far cleaner, {found:.3g}: {unit}"
    elif found < declared / CLEANER:
        note = f"cleaner than declared: {found:.3g} would weigh them as they deserve"
    return Comparison(
        key=key, declared=declared, found=found, wrong=words, note=note, adopted=noisier
    )


def _outside_the_model(key: str, declared: float, found: float) -> Comparison:
    """Return the comparison for a torque beyond its declared noise that is correlated in time."""
    note = "correlated in time, and noisier than declared: sigma counts what is found"
    return Comparison(key=key, declared=declared, found=found, note=note, adopted=True)


def _too_long(
    config: Config, degree: int, misfits: Mapping[str, tuple[Noise, float]]
) -> Comparison:
    """Return the comparison for windows that are too long; found: the longest one that fits.

    `misfits`: noise and declared sigma of the channels that do not fit, by key. Halves, quarters
    and so on of the window are tried.
    """
    key, (worst, least) = max(misfits.items(), key=lambda item: item[1][0].misfit / item[1][1])
    window_s, name = config.estimator.window_s, "estimator.window_s"
    words = (
        f"window too long for this motion: readings of {key.rpartition('.')[0]} are "
        f"{worst.misfit:.2g} off its polynomial, {worst.misfit / least:.2g} times their noise"
    )
    pieces = {own: noise.pieces for own, (noise, _) in misfits.items()}
    for halvings in range(1, SHORTEST):
        shorter_s = window_s / 2**halvings
        estimator = config.estimator.model_copy(update={"window_s": shorter_s})
        pieces = {
            own: [h for p in held for h in _halves(p, degree)] for own, held in pieces.items()
        }
        if window_faults(config.model_copy(update={"estimator": estimator})) or not all(
            pieces.values()
        ):
            break
        fits = [
            _residual(pieces[own], degree) <= MISFIT * most for own, (_, most) in misfits.items()
        ]
        if all(fits):
            wrong = f"{words}; set {name} to {shorter_s:.3g}"
            return Comparison(
                key=name, declared=window_s, found=shorter_s, wrong=wrong, adopted=True
            )
    wrong = f"{words}; move more slowly, or record at a higher rate with a shorter window"
    return Comparison(key=name, declared=window_s, found=window_s / 2, wrong=wrong)
