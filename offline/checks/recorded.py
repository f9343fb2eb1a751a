"""Compare rates and attitude in recorded windows with the values of a configuration."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fsw.config import Config
from fsw.drivers.codecs.entries import imu_codec
from fsw.messages import ChannelWindow, FloatArray, Window
from offline.checks.comparison import WRONG, Comparison
from offline.checks.noise import noise_findings
from offline.checks.trial import joined, unwrapped

RATE_TOLERANCE, RATE_SIGMAS = 0.02, 4.0
DOUBLED = 1.5  # ratio of received to declared rate that the ends of a recording do not explain
OTHER_RATIO = 10.0  # the same if the declared rate is wrong too
UNIT_RATIO = 1.3  # of a ratio of rates to a power of 1000 that shows another unit of time
BEYOND = 0.05  # accepted share of samples of a source that are out of range
JOINTS, IMU = "joints", "imu"  # sources of the status, besides the buses
LIMITS = {  # keys of a joint's limits, and other units of readings, by its kind
    "revolute": ("torque_limit_nm, speed_limit_rad_s", "mN m, degrees"),
    "prismatic": ("force_limit_n, speed_limit_m_s", "mN, mm"),
}
WIDE = 3000.0  # factor on limits that accepts readings in any unit: 57, 1000
MISSING = 0.2  # accepted share of samples without a torque
TURNED_RAD = 1e-3  # least rotation between two solutions that shows the sense of rotation
SENSE_RATIO = 0.3  # another sense is correct if its residual is smaller by this ratio


@dataclass(frozen=True, slots=True, kw_only=True)
class DataFindings:
    """Findings that need the samples alone, and no model of the robot."""

    rates: Sequence[Comparison] = ()
    noise: Sequence[Comparison] = ()
    samples: Sequence[str] = ()  # what is wrong with the samples of a joint
    poses: int = 0  # number of static poses of which the recording consists; 0: it has motions

    def lines(self) -> list[str]:
        """Return one line for each finding."""
        compared = [own.text() for own in (*self.rates, *self.noise)]
        words = (
            f"{self.poses} static poses of one window each: their noise and clock are not judged"
        )
        still = [words] if self.poses else []
        return [*still, *compared, *(f"{WRONG}{text}" for text in self.samples)]

    @property
    def wrong(self) -> list[str]:
        """The lines of what is wrong."""
        return [line for line in self.lines() if WRONG in line]


def data_findings(
    config: Config,
    windows: Sequence[Window],
    counts: Mapping[str, Mapping[str, int]],
    lasted_s: float,
    by_frames: Sequence[Comparison] = (),
) -> DataFindings:
    """Return the findings in windows.

    `counts`: number of samples by source, as in the status; `lasted_s`: length of the recording;
    `by_frames`: rates of buses that their frames show.
    """
    if not windows:
        return DataFindings()
    even, poses = unwrapped(config, windows), poses_count(windows)
    received = counts.get(IMU, {"received": 0})["received"]
    return DataFindings(
        rates=rate_findings(config, windows, received / lasted_s, by_frames),
        noise=() if poses else noise_findings(config, even),
        samples=sample_findings(config, windows),
        poses=poses,
    )


def range_findings(config: Config, counts: Mapping[str, Mapping[str, int]]) -> list[str]:
    """Return a line for each source of which many samples are beyond the configured limits."""
    limits = {bus.name: _joint_limits(config, bus.name) for bus in config.buses}
    limits[JOINTS] = _joint_limits(config, None)
    limits[IMU] = "imu.max_rate_rad_s, imu.acc_range_g", "deg/s, g"
    return [
        f"{source}: {100 * share:.0f} % of its samples are rejected, beyond {keys}; are they in "
        f"another unit ({units})?"
        for source, (keys, units) in limits.items()
        if (own := counts.get(source)) is not None
        and (share := own["reject_range"] / max(own["received"], 1)) > BEYOND
    ]


def _joint_limits(config: Config, bus: str | None) -> tuple[str, str]:
    """Return the keys of the limits of a bus's joints (None: of all), and other units of them."""
    kinds = {joint.kind for joint in config.joints if bus in (None, joint.bus)}
    keys, units = zip(*(LIMITS[kind] for kind in LIMITS if kind in kinds or not kinds), strict=True)
    return f"{', '.join(keys)} of joints", ", ".join(units)


def with_wide_limits(config: Config) -> Config:
    """Return a configuration, for diagnosis only, that accepts readings in any unit."""
    joints = tuple(
        joint.model_copy(
            update={
                "speed_limit_rad_s": WIDE * joint.speed_limit_rad_s,
                "torque_limit_nm": WIDE * joint.torque_limit_nm,
            }
        )
        for joint in config.joints
    )
    imu = config.imu
    if not imu.is_serial:  # a codec of bytes knows its unit
        limits = {
            "max_rate_rad_s": WIDE * imu.max_rate_rad_s,
            "acc_range_g": WIDE * imu.acc_range_g,
        }
        imu = imu.model_copy(update=limits)
    return config.model_copy(update={"joints": joints, "imu": imu})


def rate_findings(
    config: Config,
    windows: Sequence[Window],
    received_hz: float,
    by_frames: Sequence[Comparison] = (),
) -> list[Comparison]:
    """Return a finding for the rate of each channel, from the median step between samples.

    Samples that are counted by the declared rate cannot show it; `by_frames` is used instead.

    If inertial datagrams are received at a far higher rate than declared, `received_hz`, this is
    the rate found, because samples between the declared ones are rejected. `windows` is not empty.
    """
    found = []
    known = {own.key: own for own in by_frames}
    for i, bus in enumerate(config.buses):
        if (key := f"buses.{i}.rate_hz") in known:
            found.append(known[key])
            continue
        members = [k for k, joint in enumerate(config.joints) if joint.bus == bus.name]
        channels = [window.joints[k] for window in windows for k in members]
        found.append(_rate(key, bus.rate_hz, channels))
    imu = config.imu
    if imu.present:
        accepted = _rate("imu.rate_hz", imu.rate_hz, [window.gyro for window in windows])
        rates_hz = imu_codec(imu).rates_hz if imu.is_serial else ()
        doubled = _compared("imu.rate_hz", imu.rate_hz, received_hz, rates_hz=rates_hz)
        found.append(doubled if received_hz > DOUBLED * imu.rate_hz else accepted)
    tracker = config.star_tracker
    if tracker is not None:
        times = np.concatenate([window.attitude.t_ns for window in windows])
        found.append(_compared("star_tracker.rate_hz", tracker.rate_hz, *_rate_of(np.diff(times))))
    return found


def _rate(key: str, declared_hz: float, channels: Sequence[ChannelWindow]) -> Comparison:
    steps = [np.diff(channel.t_ns) for channel in channels if len(channel.t_ns) > 1]
    own = _rate_of(np.concatenate(steps) if steps else np.empty(0))
    return _compared(key, declared_hz, *own)


def _rate_of(steps_ns: NDArray[np.generic]) -> tuple[float, float]:
    """Return the rate [Hz] of the median step, and its accepted relative error; 0: no steps.

    The median of n steps that scatter has a standard error of 1.25 sigma / sqrt(n).
    """
    steps = steps_ns.astype(float)
    steps = steps[steps > 0]
    if not steps.size:
        return 0.0, RATE_TOLERANCE
    middle = float(np.median(steps))
    sigma = 1.48 * float(np.median(np.abs(steps - middle)))
    error = 1.25 * sigma / middle / float(np.sqrt(steps.size))
    return 1e9 / middle, RATE_TOLERANCE + RATE_SIGMAS * error


def _compared(
    key: str,
    declared_hz: float,
    found_hz: float,
    tolerance: float = RATE_TOLERANCE,
    rates_hz: Sequence[float] = (),
) -> Comparison:
    """Return the finding for a rate; `rates_hz`: rates that the device offers, empty: any."""
    fits = abs(found_hz / declared_hz - 1.0) <= tolerance
    near_hz = min(rates_hz, key=lambda rate_hz: abs(rate_hz - found_hz), default=found_hz)
    words = rate_words(key, declared_hz, found_hz) or f"set {key} to {near_hz:.4g}"
    words = words if found_hz else "no samples are used; see the warnings"
    return Comparison(key=key, declared=declared_hz, found=found_hz, wrong="" if fits else words)


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


def rate_words(key: str, declared_hz: float, found_hz: float) -> str:
    """Return what to correct if the rates show stamps in a wrong unit; empty: they do not."""
    ratio = found_hz / declared_hz if found_hz > 0.0 else 1.0
    for power in (1, 2, 3):
        thousands = 1000**power
        for factor, size in ((thousands, "small"), (1.0 / thousands, "large")):
            left = ratio / factor
            if not 1.0 / OTHER_RATIO < left < OTHER_RATIO:
                continue
            words = (
                f"the stamps are {thousands:g} times too {size} for {key} {declared_hz:g}: "
                "correct the unit of time (s, ms, us, ns)"
            )
            if 1.0 / UNIT_RATIO < left < UNIT_RATIO:
                return words
            return f"{words}, and set {key} to {left * declared_hz:.4g}"
    return ""


def sample_findings(config: Config, windows: Sequence[Window]) -> list[str]:
    """Return a line for each joint whose angle wraps, or whose torque is missing too often."""
    lines = []
    for k, joint in enumerate(config.joints):
        own = [window.joints[k] for window in windows if len(window.joints[k].t_ns)]
        if not own:
            continue
        stream = joined(own)
        count = int(np.count_nonzero(np.diff(stream.turns(joint))))
        if count:
            lines.append(
                f"joints.{k} ({joint.name}): its angle wraps: {count} jumps of a turn; unwrap "
                "it where it is recorded or imported"
            )
        missing = float(np.mean(np.isnan(stream.values[:, 1])))
        if joint.torque != "none" and missing > MISSING:
            ((key, limit),) = joint.named({"torque_limit_nm": joint.torque_limit_nm}).items()
            what, units = (
                ("force", "N, mN") if joint.kind == "prismatic" else ("torque", "N m, mN m")
            )
            lines.append(
                f"joints.{k} ({joint.name}): its {what} is missing in {100 * missing:.0f} % of the "
                f"samples; were values beyond {key} {limit:g} rejected "
                f"(look at their unit: {units}), or frames shorter than described?"
            )
    return lines


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
    follows = _follow(windows)
    expected = np.diff([np.interp(stamps, t_ns, turns[:, axis]) for axis in range(3)]).T[follows]
    if not len(expected) or np.linalg.norm(expected, axis=1).max() < TURNED_RAD:
        return []
    senses = {"inertial_to_tracker", "tracker_to_inertial"} - {tracker.rotation}
    sense = f"star_tracker.rotation: the quaternion turns the other way; set it to {senses.pop()}"
    ways = {
        "": R_NB,
        sense: (R_NB * q_BT).inv() * q_BT.inv(),
        "star_tracker.mounting.q_BS_xyzw: is that of B to S; its inverse takes S to B": R_NB
        * q_BT
        * q_BT,
    }
    left = {words: _misfit(turned, follows, expected) for words, turned in ways.items()}
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


def _follow(windows: Sequence[Window]) -> NDArray[np.bool_]:
    """Return whether no window is missing between two successive solutions of the tracker."""
    gaps = np.diff([window.index for window in windows], prepend=windows[0].index) > 1
    stretch = np.repeat(np.cumsum(gaps), [len(window.attitude.t_ns) for window in windows])
    return np.asarray(stretch[1:] == stretch[:-1], np.bool_)


def _misfit(R_NB: Rotation, follows: NDArray[np.bool_], expected: FloatArray) -> float:
    turns = (R_NB[:-1].inv() * R_NB[1:]).as_rotvec()[follows]
    return float(np.sqrt(np.mean(np.sum((turns - expected) ** 2, axis=1))))
