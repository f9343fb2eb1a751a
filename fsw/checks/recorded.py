"""Compare rates, noise and attitude in recorded windows with the values of a configuration."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fsw.checks.budget import IMU_RATES_HZ
from fsw.config import Config
from fsw.estimators.polynomial import EXTRA_DEGREE
from fsw.messages import ChannelWindow, FloatArray, Window

OTHER_UNIT = 30.0  # declared noise too large by this ratio: a wrong unit gives 57 or 60
RATE_TOLERANCE = 0.02
DOUBLED = 1.5  # ratio of received to declared rate that the ends of a recording do not explain
NOISE_RATIO = 2.0  # accepted ratio of found to declared noise, or of declared to found
TURNED_RAD = 1e-3  # least rotation between two solutions that shows the sense of rotation
SENSE_RATIO = 0.3  # another sense is correct if its residual is smaller by this ratio


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """Declared and found value of one key; `wrong` and `note` are words, empty if it fits."""

    key: str
    declared: float
    found: float
    wrong: str = ""
    note: str = ""

    def text(self) -> str:
        """Return the finding as a line of text."""
        verdict = f"WRONG: {self.wrong}" if self.wrong else self.note or "fits"
        return f"{self.key}: declared {self.declared:.3g}, found {self.found:.3g}; {verdict}"


def rate_findings(config: Config, windows: Sequence[Window], datagrams: int) -> list[Finding]:
    """Return a finding for the rate of each channel, from the median step between samples.

    If far more `datagrams` are received than declared, the rate of the inertial unit is that of the
    datagrams, because samples between the declared ones are rejected. `windows` is not empty.
    """
    found = []
    for i, bus in enumerate(config.buses):
        members = [k for k, joint in enumerate(config.joints) if joint.bus == bus.name]
        channels = [window.joints[k] for window in windows for k in members]
        found.append(_rate(f"buses.{i}.rate_hz", bus.rate_hz, channels))
    imu = config.imu
    received_hz = datagrams * 1e9 / (windows[-1].stop_ns - windows[0].start_ns)
    if imu.present:
        accepted = _rate("imu.rate_hz", imu.rate_hz, [window.gyro for window in windows])
        rates_hz = IMU_RATES_HZ if imu.driver == "stim300" else ()
        doubled = _compared("imu.rate_hz", imu.rate_hz, received_hz, rates_hz)
        found.append(doubled if received_hz > DOUBLED * imu.rate_hz else accepted)
    tracker = config.star_tracker
    if tracker is not None:
        times = np.concatenate([window.attitude.t_ns for window in windows])
        found.append(_compared("star_tracker.rate_hz", tracker.rate_hz, _rate_of(np.diff(times))))
    return found


def _rate(key: str, declared_hz: float, channels: Sequence[ChannelWindow]) -> Finding:
    steps = [np.diff(channel.t_ns) for channel in channels if len(channel.t_ns) > 1]
    return _compared(key, declared_hz, _rate_of(np.concatenate(steps) if steps else np.empty(0)))


def _rate_of(steps_ns: NDArray[np.generic]) -> float:
    steps = steps_ns.astype(float)
    steps = steps[steps > 0]
    return 1e9 / float(np.median(steps)) if steps.size else 0.0


def _compared(
    key: str, declared_hz: float, found_hz: float, rates_hz: Sequence[float] = ()
) -> Finding:
    """Return the finding for a rate; `rates_hz`: rates that the device offers, empty: any."""
    fits = abs(found_hz / declared_hz - 1.0) <= RATE_TOLERANCE
    near_hz = min(rates_hz, key=lambda rate_hz: abs(rate_hz - found_hz), default=found_hz)
    words = f"set {key} to {near_hz:.4g}" if found_hz else "no samples are used; see the warnings"
    return Finding(key=key, declared=declared_hz, found=found_hz, wrong="" if fits else words)


def poses_count(windows: Sequence[Window]) -> int:
    """Return the number of static poses if each window repeats the readings of one; else 0.

    `fsw import` writes such recordings from tables of poses; no sensor gives them.
    """
    held = [
        np.concatenate([channel.values for channel in window.joints], axis=1)
        for window in windows
        if window.joints
        and all(len(channel.t_ns) for channel in window.joints)
        and len({len(channel.t_ns) for channel in window.joints}) == 1
    ]
    if not held or any(np.nanmax(np.ptp(values, axis=0)) > 0.0 for values in held):
        return 0
    poses = np.unique([values[0] for values in held], axis=0)
    return len(poses) if len(poses) > 1 else 0


def noise_findings(config: Config, windows: Sequence[Window]) -> list[Finding]:
    """Return a finding for the noise of each channel, which is the residual of polynomial fits."""
    found = []
    low = config.estimator.nodes - 1
    high = low + EXTRA_DEGREE
    for k, joint in enumerate(config.joints):
        channels = [window.joints[k] for window in windows]
        angle, torque = _noise(channels, 0, high), _noise(channels, 1, high)
        noise = {"position_noise_rad": (joint.position_noise_rad, angle)}
        if joint.speed_noise_rad_s is not None:
            noise = {"speed_noise_rad_s": (joint.speed_noise_rad_s, angle)}
        if joint.torque != "none":
            noise = {"torque_noise_nm": (joint.torque_noise_nm, torque)} | noise
        for key, pair in joint.named(noise).items():
            found.append(_noise_finding(f"joints.{k}.{key}", *pair))
    imu, root = config.imu, config.imu.rate_hz**-0.5
    if not imu.present:
        return found
    for key, declared, channels in (
        ("angle_random_walk_rad_sqrt_s", imu.angle_random_walk_rad_sqrt_s, _gyro(windows)),
        (
            "velocity_random_walk_m_s_sqrt_s",
            imu.velocity_random_walk_m_s_sqrt_s,
            [window.accelerometer for window in windows],
        ),
    ):
        sigma = float(np.median([_noise(channels, axis, high) for axis in range(3)]))
        found.append(_noise_finding(f"imu.{key}", declared, sigma * root))
    return found


def _gyro(windows: Sequence[Window]) -> list[ChannelWindow]:
    return [window.gyro for window in windows]


def _noise(channels: Sequence[ChannelWindow], column: int, degree: int) -> float:
    """Return the median over the windows of 1 sigma about a polynomial; 0: too few samples."""
    sigmas = []
    for channel in channels:
        values = channel.values[:, column] if len(channel.t_ns) else np.empty(0)
        good = np.isfinite(values)
        if np.count_nonzero(good) < 2 * degree + 2:
            continue
        t = channel.t_ns[good] - channel.t_ns[good][0]
        basis = legendre.legvander(2.0 * t / max(t[-1], 1) - 1.0, degree)
        _, squares, rank, _ = np.linalg.lstsq(basis, values[good], rcond=None)
        if squares.size:
            sigmas.append(float(np.sqrt(squares[0] / (len(t) - rank))))
    return float(np.median(sigmas)) if sigmas else 0.0


def _noise_finding(key: str, declared: float, found: float) -> Finding:
    words = note = ""
    if found > NOISE_RATIO * declared:
        words = f"the data are noisier: set {key} to {found:.3g}, or look for disturbances"
    elif found < declared / NOISE_RATIO and found > 0.0:
        note = f"cleaner than declared: {found:.3g} would weigh them as they deserve"
        if found < declared / OTHER_UNIT:
            words = (
                f"the data are far cleaner, {found:.3g}: is {key} in another unit (degrees, hours)?"
            )
    elif found == 0.0:
        words = "the readings do not change, or there are too few"
    return Finding(key=key, declared=declared, found=found, wrong=words, note=note)


def tracker_findings(config: Config, windows: Sequence[Window]) -> list[str]:
    """Return a line if the tracker's rotations differ from the gyro's or are too few, else none."""
    tracker = config.star_tracker
    if tracker is None or not any(len(window.gyro.t_ns) for window in windows):
        return []
    R_BS = Rotation.from_quat(config.imu.mounting.q_BS_xyzw)
    t_ns, turns = _turns(windows, R_BS)
    attitudes = [q for window in windows for q in window.attitude.values]
    if len(attitudes) < 3:
        return ["star_tracker: too few solutions are used to judge its mounting and sense"]
    R_NB = Rotation.from_quat(np.array(attitudes))
    q_BT = Rotation.from_quat(tracker.mounting.q_BS_xyzw)
    stamps = np.concatenate([window.attitude.t_ns for window in windows])
    expected = np.diff([np.interp(stamps, t_ns, turns[:, axis]) for axis in range(3)]).T
    if np.linalg.norm(expected, axis=1).max() < TURNED_RAD:
        return []
    ways = {
        "": R_NB,
        "star_tracker.rotation: the quaternion turns the other way": (R_NB * q_BT).inv()
        * q_BT.inv(),
        "star_tracker.mounting.q_BS_xyzw: is that of B to S; its inverse takes S to B": R_NB
        * q_BT
        * q_BT,
    }
    left = {words: _misfit(turned, expected) for words, turned in ways.items()}
    best = min(left, key=lambda words: left[words])
    right = not best or left[best] > SENSE_RATIO * left[""]
    if not right:
        return [
            f"{best} (turns differ from the gyro's by {left['']:.2g} rad, then {left[best]:.2g})"
        ]
    noise = 10.0 * max(tracker.noise_about_rad, tracker.noise_across_rad)
    scale = float(np.sqrt(np.mean(np.sum(expected**2, axis=1))))
    if left[""] > max(noise, 0.1 * scale):
        return [
            "star_tracker.mounting: turns differ from the gyro's by "
            f"{left['']:.2g} rad of {scale:.2g}; the mounting of one of the two is wrong"
        ]
    return []


def _turns(windows: Sequence[Window], R_BS: Rotation) -> tuple[FloatArray, FloatArray]:
    """Return times (k,) [ns] and the gyro's integral (k, 3) [rad] in B, for small rotations."""
    t_ns = np.concatenate([window.gyro.t_ns for window in windows])
    rates = R_BS.apply(np.concatenate([window.gyro.values for window in windows]))
    steps = np.diff(t_ns, prepend=t_ns[:1]) * 1e-9
    return t_ns.astype(np.float64), np.cumsum(rates * steps[:, None], axis=0)


def _misfit(R_NB: Rotation, expected: FloatArray) -> float:
    turns = (R_NB[:-1].inv() * R_NB[1:]).as_rotvec()
    return float(np.sqrt(np.mean(np.sum((turns - expected) ** 2, axis=1))))
