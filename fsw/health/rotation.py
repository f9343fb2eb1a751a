"""Cross-check of gyro and star tracker: both give the rotation between two solutions.

The last trusted attitude, turned by the integrated gyro rate, predicts the next solution. If one
solution is off and later ones agree with it, the tracker is at fault (another star field, a flip).
If pair after pair of solutions is off, the rate between them is wrong and the gyro is at fault. If
pairs turn by the gyro's angle but about another axis, no sensor is at fault: a rotation or mounting
is configured wrongly, and the gyro is still used.
"""

from dataclasses import replace
from math import cos, sin, sqrt

import numpy as np

from fsw.config import Config
from fsw.messages import FloatArray, Window
from fsw.messages.findings import Fault, Finding

TRACKER = "star_tracker"
SIGMAS = 8.0  # of the white noise in the comparison
SPIKE_SIGMAS = 8.0  # a single reading this far from its neighbours' median is not integrated
MEDIAN_OF = 5
TIMING_S = 0.005  # largest time error between the two sensors
FLIP_RAD = 2.0  # half a turn is larger, a jump to another star field is smaller
GYRO_PAIRS = 2  # bad pairs in a row that show a fault of the gyro, and good pairs that end it
# Turns of the same size about another axis. A gyro error across the turn and as large as the turn
# makes the rate 41 % too high: for turns of ten sigma and more this is never the same size.
SAME_RATIO = 0.05  # of a turn, plus two sigma: turns that differ by less have the same size
CLEAR_SIGMAS = 10.0  # of noise: smaller turns show nothing
TURNED_PAIRS = 5  # pairs in a row that show a wrong configuration
RETRUST = 50  # solutions in a row that agree with one another, not with the trusted one
RETRUST_NEAR = 5  # the same, if a short fault of the gyro explains the difference
TURN_LIMIT_RAD = 0.2  # largest error of a gyro between two solutions


class RotationMonitor:
    """Judges the attitude solutions and the gyro of every window.

    Rotations are quaternions xyzw; rates are in axes of B.
    """

    def __init__(self, config: Config) -> None:
        self._enabled = config.star_tracker is not None
        imu = config.imu
        self._R_BS = _matrix(np.array(imu.mounting.q_BS_xyzw))
        tracker = config.star_tracker
        noise = max(tracker.noise_about_rad, tracker.noise_across_rad) if tracker else 0.0
        self._pair_variance = 2.0 * noise**2
        self._walk_variance = imu.angle_random_walk_rad_sqrt_s**2
        self._spike_rad_s = SPIKE_SIGMAS * imu.angle_random_walk_rad_sqrt_s * imu.rate_hz**0.5
        self._bias = SIGMAS * imu.gyro_bias_sigma_rad_s
        self._trusted: tuple[int, FloatArray] | None = None  # time, q_NB
        self._newest: tuple[int, FloatArray] | None = None  # last solution, right or wrong
        self._since_trusted = np.zeros(3)  # integral of the rate since `_trusted` [rad]
        self._since_newest = np.zeros(3)
        self._bad_pairs = self._good_pairs = self._off = 0
        self._turned_pairs = 0  # bad pairs in a row that turn by the gyro's angle
        self._misread = False  # a rotation or mounting is configured wrongly
        self.gyro_faulty = False

    def judge(self, window: Window) -> tuple[Window, list[Finding]]:
        """Return the window without the channels found wrong, and the findings."""
        if not self._enabled:
            return window, []
        gyro = window.gyro
        if gyro.missing or len(gyro.t_ns) < 2:
            self._forget()
            return window, []
        rates = without_spikes(gyro.values, self._spike_rad_s) @ self._R_BS.T
        keep = np.ones(len(window.attitude.t_ns), dtype=bool)
        findings: list[Finding] = []
        start_ns = window.start_ns
        for k, t in enumerate(window.attitude.t_ns.tolist()):
            self._turn(gyro.t_ns, rates, start_ns, t)
            start_ns = t
            found = self._solution(t, window.attitude.values[k])
            keep[k] = found is None or found.fault is Fault.GYRO_INCONSISTENT
            if found is not None:
                findings.append(found)
        self._turn(gyro.t_ns, rates, start_ns, window.stop_ns)
        if not keep.all():
            held = window.attitude
            held = replace(
                held,
                t_ns=held.t_ns[keep],
                values=held.values[keep],
                missing=held.missing or not keep.any(),
            )
            window = replace(window, attitude=held)
        if self.gyro_faulty:
            window = replace(window, gyro=replace(gyro, missing=True))
        return window, [f for f in findings if f.text]

    def _forget(self) -> None:
        """Discard the history: without the gyro the next solution cannot be predicted."""
        self._trusted = self._newest = None
        self._bad_pairs = self._good_pairs = self._off = self._turned_pairs = 0

    def _turn(self, t_ns: np.ndarray, rates: FloatArray, start_ns: int, stop_ns: int) -> None:
        """Extend both integrals of the rate from start to stop by the mean rate in between."""
        inside = (t_ns >= start_ns) & (t_ns < stop_ns)
        if inside.any():
            rate = rates[inside].mean(axis=0)
        else:
            rate = rates[np.abs(t_ns - start_ns).argmin()]
        step = rate * (stop_ns - start_ns) * 1e-9
        self._since_trusted = self._since_trusted + step
        self._since_newest = self._since_newest + step

    def _solution(self, t_ns: int, q: FloatArray) -> Finding | None:
        """Judge one solution; return its fault, or None. A finding without text is not reported."""
        if self._trusted is None or self._newest is None:
            self._trust(t_ns, q)
            self._follow(t_ns, q)
            return None
        off, limit = self._distance(self._trusted, self._since_trusted, t_ns, q)
        pair, pair_limit = self._distance(self._newest, self._since_newest, t_ns, q)
        turned = self._is_turned(pair, q)
        self._follow(t_ns, q)
        steady = pair <= pair_limit
        if not steady and pair < TURN_LIMIT_RAD:
            self._bad_pairs, self._good_pairs = self._bad_pairs + 1, 0
            self._turned_pairs = self._turned_pairs + 1 if turned else 0
            if self._turned_pairs >= TURNED_PAIRS:
                self._misread, self.gyro_faulty = True, False
        else:
            self._good_pairs, self._bad_pairs = self._good_pairs + 1, 0
            self._misread = self._misread and self._good_pairs < RETRUST
        if not self.gyro_faulty and off <= limit:
            self._trust(t_ns, q)
            self._bad_pairs = 0
            return None
        if self.gyro_faulty or self._bad_pairs >= GYRO_PAIRS:
            return self._gyro(t_ns, q, pair)
        self._off = self._off + 1 if steady else 1
        if self._off >= (RETRUST if off > TURN_LIMIT_RAD else RETRUST_NEAR):
            self._trust(t_ns, q)
            return None
        if not steady and pair < TURN_LIMIT_RAD:
            return Finding(
                t_ns, Fault.TRACKER_JUMP, "star_tracker"
            )  # not reported: the faulty sensor is not known
        fault = Fault.TRACKER_FLIP if off > FLIP_RAD else Fault.TRACKER_JUMP
        text = f"{np.degrees(off):.3g} deg from what the gyro says"
        return Finding(t_ns, fault, TRACKER, text)

    def _is_turned(self, pair: float, q: FloatArray) -> bool:
        """Return whether the turn to this solution has the gyro's angle but another axis."""
        if self._newest is None:
            return False
        between = _product(_conjugate(self._newest[1]), q)
        angle = 2.0 * float(np.arctan2(np.linalg.norm(between[:3]), abs(between[3])))
        said = float(np.linalg.norm(self._since_newest))
        sigma = float(np.sqrt(self._pair_variance))
        same = abs(angle - said) < SAME_RATIO * said + 2.0 * sigma
        return same and pair > said > CLEAR_SIGMAS * sigma

    def _gyro(self, t_ns: int, q: FloatArray, pair: float) -> Finding | None:
        if self._misread:
            text = "turns as far as the gyro, about another axis: rotation or a mounting is wrong"
            return Finding(t_ns, Fault.TRACKER_JUMP, TRACKER, text)
        self._trust(t_ns, q)
        self.gyro_faulty = self._good_pairs < GYRO_PAIRS
        if not self.gyro_faulty:
            return None
        text = f"{pair:.2g} rad off between two solutions"
        return Finding(t_ns, Fault.GYRO_INCONSISTENT, "gyro", text)

    def _trust(self, t_ns: int, q: FloatArray) -> None:
        self._trusted, self._since_trusted, self._off = (t_ns, q), np.zeros(3), 0

    def _follow(self, t_ns: int, q: FloatArray) -> None:
        self._newest, self._since_newest = (t_ns, q), np.zeros(3)

    def _distance(
        self, start: tuple[int, FloatArray], turned: FloatArray, t_ns: int, q: FloatArray
    ) -> tuple[float, float]:
        """Return the angle between prediction and solution, and the angle that noise explains."""
        elapsed_s = (t_ns - start[0]) * 1e-9
        between = _product(_conjugate(start[1]), q)
        error = _product(_conjugate(_quaternion(turned)), between)
        angle = 2.0 * float(np.arctan2(np.linalg.norm(error[:3]), abs(error[3])))
        spread = np.sqrt(self._pair_variance + self._walk_variance * max(elapsed_s, 0.0))
        rate = float(np.linalg.norm(turned)) / max(elapsed_s, 1e-3)
        limit = SIGMAS * float(spread) + self._bias * elapsed_s + rate * TIMING_S
        # summing rates as vectors makes an error of second order in the turned angle
        return angle, limit + 0.5 * float(turned @ turned) * min(elapsed_s, 1.0)


def without_spikes(values: FloatArray, limit: float) -> FloatArray:
    """Return values (k, 3); those beyond `limit` of the median of five become that median."""
    if len(values) < MEDIAN_OF:
        return values
    side, k = MEDIAN_OF // 2, len(values)
    padded = np.concatenate([values[side:0:-1], values, values[-2 : -2 - side : -1]])
    a, b, c, d, e = (padded[i : i + k] for i in range(MEDIAN_OF))
    # the middle two of four and the fifth give the median; NaN gives NaN, as with np.median
    a, b, c, d = np.minimum(a, b), np.maximum(a, b), np.minimum(c, d), np.maximum(c, d)
    low, high = np.maximum(a, c), np.minimum(b, d)
    middle = np.maximum(np.minimum(low, high), np.minimum(np.maximum(low, high), e))
    return np.where(np.abs(values - middle) > limit, middle, values)


def _matrix(q: FloatArray) -> FloatArray:
    """Return the rotation matrix of a unit quaternion."""
    x, y, z, w = q
    v = np.array([x, y, z])
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    R: FloatArray = (w * w - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) + 2.0 * w * K
    return R


def _conjugate(q: FloatArray) -> FloatArray:
    return np.array([-q[0], -q[1], -q[2], q[3]])


def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the Hamilton product: rotation b, then a."""
    ax, ay, az, aw = a.tolist()  # numpy is ten times slower for so few numbers
    bx, by, bz, bw = b.tolist()
    x = aw * bx + bw * ax + (ay * bz - az * by)
    y = aw * by + bw * ay + (az * bx - ax * bz)
    z = aw * bz + bw * az + (ax * by - ay * bx)
    return np.array([x, y, z, aw * bw - (ax * bx + ay * by + az * bz)])


def _quaternion(turn_rad: FloatArray) -> FloatArray:
    """Return the quaternion of a rotation vector [rad]."""
    x, y, z = turn_rad.tolist()
    half = 0.5 * sqrt(x * x + y * y + z * z)
    share = 0.5 * sin(half) / half if half else 0.5
    return np.array([share * x, share * y, share * z, cos(half)])
