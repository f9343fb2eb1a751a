"""Turn mapped columns of a table into channels of decoded samples.

The recording contains the values that the sensors measured, in SI units. The replay applies
calibration and delays of the configuration, as the daemon does to received values.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fsw.commands.importing.captures import Channel
from fsw.commands.importing.mapping import (
    FACTORS,
    Imu,
    Joints,
    Mapping,
    Quantity,
    Source,
    StarTracker,
    TimeColumn,
    Wheels,
)
from fsw.commands.importing.stamps import judged
from fsw.commands.importing.tables import Table
from fsw.commands.importing.usable import Part, jumps, usable
from fsw.config import Config
from fsw.drivers.codecs.stim300 import STANDARD_GRAVITY_M_S2
from fsw.drivers.sources.joint_track import SLACK_SIGMAS, Calibration
from fsw.drivers.sources.samples import (
    FORCE,
    NORM_TOLERANCE,
    POSITION,
    QUATERNION,
    RATE,
    SPEED,
    TORQUE,
)
from fsw.exchange.recording import END_NS, SAMPLES
from fsw.exchange.recording_writer import RecordingWriter
from fsw.messages import FloatArray, IntArray
from fsw.messages.errors import ConfigError

UNITS = {
    POSITION: "rad",
    TORQUE: "N m",
    RATE: "rad/s",
    FORCE: "m/s2",
    QUATERNION: "",
    SPEED: "rad/s",
}
MOST_RAD = 1e6  # no encoder counts to larger angles


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Found:
    """One source's values in SI units."""

    parts: dict[str, FloatArray]  # (k, width) by key in the message; NaN: missing
    needed: str  # rows without this part are left out; empty: rows without any value
    words: Callable[[FloatArray], Any]  # returns values (width,) in the form of the message
    rates_hz: dict[str, float]  # declared rates by key of the configuration
    troubles: list[str]  # describe the rejected values
    steps: Callable[[FloatArray, IntArray], list[str]] = lambda *_: []  # judges `needed`


def sampled_channels(
    config: Config, mapping: Mapping, folder: Path, file: Path | None
) -> Iterator[Channel]:
    """Yield the channels that a mapping describes.

    Parameters
    ----------
    folder : folder of the mapping; paths of files in the mapping are relative to it
    file : file of the sections that name no file

    Raises
    ------
    ConfigError when columns or stamps cannot be used, or belong to another robot.
    """
    tables: dict[Path, Table] = {}

    def open_table(name: str, section: Source) -> Table:
        path = file if section.file is None else folder / section.file
        if path is None:
            raise ConfigError(f"{name}.file: missing, and the command line has no FILE")
        tables[path] = tables[path] if path in tables else Table(path)
        return tables[path]

    for name, section in mapping.sections.items():
        table, time = open_table(name, section), mapping.time_of(name, section)
        stamps = table.column(time.column) * FACTORS[time.unit]
        if isinstance(section, Joints):
            found = _joints(config, section, table, stamps)
        elif isinstance(section, Wheels):
            found = _wheels(config, section, table)
        elif isinstance(section, Imu):
            found = _imu(config, section, table)
        else:
            found = _star_tracker(config, section, table)
        yield _channel(name, table, time, stamps, found)


def _joints(config: Config, section: Joints, table: Table, stamps: FloatArray) -> _Found:
    names = [joint.name for joint in config.joints]
    order = names if section.order is None else list(section.order)
    if sorted(order) != sorted(names):
        raise ConfigError(
            f"joints.order: {' '.join(order)}; {config.name} has {' '.join(names)}: the mapping of "
            "another robot"
        )
    if config.thrusters:
        raise ConfigError(f"thrusters: {config.name} has some, and no mapping holds them")
    turning = [joint.name for joint in config.joints if joint.speed_only]
    if turning:
        raise ConfigError(
            f"joints.encoder: {turning[0]} has encoder: speed in {config.name}, and no mapping "
            "holds speeds"
        )
    sensing = [joint.name for joint in config.joints if joint.torque != "none"]
    if section.torque is None and sensing:
        raise ConfigError(
            f"joints.torque: missing; {' '.join(sensing)} have torque sensors in {config.name}"
        )
    used = {joint.bus for joint in config.joints}
    buses = [(i, bus) for i, bus in enumerate(config.buses) if bus.name in used]
    rates_hz = {f"buses.{i}.rate_hz": bus.rate_hz for i, bus in buses}
    joints = [config.joints[names.index(name)] for name in order]
    calibration, every = Calibration(joints), np.arange(len(order))
    position = _part(table, "joints.position", section.position, order)
    angles, _ = calibration.apply(every, position.finite, np.zeros(len(order)))
    known_s = stamps[np.isfinite(stamps)]
    stamped_s = float(np.ptp(known_s)) if known_s.size else 0.0
    lasted_s = max(len(angles) / min(rates_hz.values()), stamped_s)
    limits = np.array([joint.speed_limit_rad_s for joint in joints])
    noise = SLACK_SIGMAS * np.array([joint.position_noise_rad for joint in joints])
    reach = limits * lasted_s + noise
    is_far = np.abs(angles - _middle(angles)) > reach
    bounds = [f"out of reach at {joint.speed_limit_rad_s:g} rad/s" for joint in joints]
    values, troubles = usable(table.path, position, is_far, bounds)
    parts = {POSITION: values}
    if section.torque is not None:
        is_sensed = [joint.torque != "none" for joint in joints]
        torque = _part(table, "joints.torque", section.torque, order, is_sensed)
        _, torques = calibration.apply(every, np.zeros(len(order)), torque.finite)
        is_far = np.abs(torques) > np.array([joint.torque_limit_nm for joint in joints])
        bounds = [f"beyond {joint.torque_limit_nm:g} N m" for joint in joints]
        parts[TORQUE], more = usable(table.path, torque, is_far, bounds)
        troubles += more
    periods_s = {bus.name: 1.0 / bus.rate_hz for _, bus in buses}
    slack = noise + limits * np.array([periods_s[joint.bus] for joint in joints])
    return _Found(
        parts=parts,
        needed=POSITION,
        words=_by_name(order),
        rates_hz=rates_hz,
        troubles=troubles,
        steps=lambda values, t_ns: jumps(position.columns, values, t_ns, limits, slack),
    )


def _wheels(config: Config, section: Wheels, table: Table) -> _Found:
    names = [wheel.name for wheel in config.wheels]
    sensing = [wheel.name for wheel in config.wheels if wheel.torque != "none"]
    if sensing:
        raise ConfigError(
            f"wheels: {' '.join(sensing)} have torque: measured in {config.name}, and no mapping "
            "holds it"
        )
    speed = _part(table, "wheels.speed", section.speed, names)
    limits = [wheel.speed_limit_rad_s for wheel in config.wheels]
    values, troubles = _within(table, speed, limits, "rad/s")
    rates_hz = {f"wheels.{i}.rate_hz": wheel.rate_hz for i, wheel in enumerate(config.wheels)}
    words = _by_name(names)
    return _Found(
        parts={SPEED: values}, needed=SPEED, words=words, rates_hz=rates_hz, troubles=troubles
    )


def _imu(config: Config, section: Imu, table: Table) -> _Found:
    rate = _part(table, "imu.rate", section.rate, "xyz")
    values, troubles = _within(table, rate, [config.imu.max_rate_rad_s] * 3, "rad/s")
    parts = {RATE: values}
    if section.specific_force is not None:
        force = _part(table, "imu.specific_force", section.specific_force, "xyz")
        limit = config.imu.acc_range_g * STANDARD_GRAVITY_M_S2
        parts[FORCE], more = _within(table, force, [limit] * 3, "m/s2")
        troubles += more
    rates_hz = {"imu.rate_hz": config.imu.rate_hz}
    return _Found(parts=parts, needed="", words=_listed, rates_hz=rates_hz, troubles=troubles)


def _star_tracker(config: Config, section: StarTracker, table: Table) -> _Found:
    q, tracker = section.quaternion, config.star_tracker
    part = _part(table, "star_tracker.quaternion", q, q.order)
    length = np.hypot.reduce(part.finite, axis=1, keepdims=True)
    is_far = np.repeat(np.abs(length - 1.0) > NORM_TOLERANCE, len(q.order), axis=1)
    bounds = [f"of a quaternion that is not of length 1 within {NORM_TOLERANCE:g}"] * len(q.order)
    values, troubles = usable(table.path, part, is_far, bounds)
    values = values[:, [q.order.index(axis) for axis in "xyzw"]]
    rates_hz = {} if tracker is None else {"star_tracker.rate_hz": tracker.rate_hz}
    return _Found(
        parts={QUATERNION: values},
        needed=QUATERNION,
        words=_listed,
        rates_hz=rates_hz,
        troubles=troubles,
    )


def _within(
    table: Table, part: Part, limits: Sequence[float], unit: str
) -> tuple[FloatArray, list[str]]:
    """Return values of at most `limits`, others as NaN, and lines on the rejected ones."""
    bounds = [f"beyond {limit:.4g} {unit}" for limit in limits]
    return usable(table.path, part, np.abs(part.finite) > np.array(limits), bounds)


def _middle(values: FloatArray) -> FloatArray:
    """Return each column's median (width,) [rad] of values up to MOST_RAD; 0 if there are none."""
    columns = [column[np.abs(column) <= MOST_RAD] for column in values.T]
    return np.array([np.median(column) if column.size else 0.0 for column in columns])


def _by_name(names: Sequence[str]) -> Callable[[FloatArray], dict[str, float]]:
    """Return a function that returns the finite values of a row by name."""

    def words(values: FloatArray) -> dict[str, float]:
        finite = np.isfinite(values).tolist()
        rows = zip(names, values.tolist(), finite, strict=True)
        return {name: value for name, value, is_known in rows if is_known}

    return words


def _listed(values: FloatArray) -> list[float]:
    known: list[float] = values.tolist() if np.isfinite(values).all() else []
    return known


def _part(
    table: Table,
    key: str,
    quantity: Quantity,
    slots: Sequence[str],
    is_read: Sequence[bool] = (),
) -> Part:
    """Return a quantity's columns in SI units, (k, len(slots)); slots: joints, wheels or axes."""
    if not slots:
        source = key.partition(".")[0]
        raise ConfigError(f"{key}: mapped, and the configuration has no {source}")
    names = quantity.columns
    if len(names) == 1 and "{}" in names[0]:
        names = tuple(names[0].replace("{}", slot) for slot in slots)
    columns = [table.column(name) for name in names]
    if len({len(column) for column in columns}) > 1:
        lengths = ", ".join(str(len(column)) for column in columns)
        raise ConfigError(f"{table.path}: {key}: columns of different lengths: {lengths}")
    values = np.concatenate(columns, axis=1)
    if values.shape[1] != len(slots):
        raise ConfigError(
            f"{table.path}: {key}: {values.shape[1]} columns; must be {len(slots)}, for "
            f"{' '.join(slots)}"
        )
    factor = np.full(len(slots), FACTORS[quantity.unit])
    for name, given in (("scale", quantity.scale), ("sign", quantity.sign)):
        if len(given) not in (1, len(slots)):
            raise ConfigError(f"{key}.{name}: {len(given)} values; must be 1 or {len(slots)}")
        factor = factor * np.array(given)
    if len(names) != len(slots):
        names = tuple(f"{names[0]}[{k}]" for k in range(len(slots)))
    with np.errstate(over="ignore", invalid="ignore"):
        return Part(key=key, columns=names, values=values * factor, is_read=is_read)


def _channel(
    name: str, table: Table, time: TimeColumn, stamps: FloatArray, found: _Found
) -> Channel:
    """Return a channel of the usable rows in order of time."""
    values = np.concatenate(list(found.parts.values()), axis=1)
    if len(stamps) != len(values) or stamps.shape[1] != 1:
        raise ConfigError(
            f"{table.path}: time column {time.column!r} has {len(stamps)} rows of "
            f"{stamps.shape[1]}; must be {len(values)} of 1, as {name}"
        )
    needed = found.parts[found.needed] if found.needed else values
    is_known = np.isfinite(needed)
    rows = np.flatnonzero(is_known.all(axis=1) if found.needed else is_known.any(axis=1))
    lost = len(values) - len(rows)
    needs = f"every {found.needed}" if found.needed else "any value"
    troubles = [*found.troubles, *([f"rows without {needs}, left out: {lost}"] if lost else [])]
    wrong = ~((stamps[rows, 0] >= 0.0) & (stamps[rows, 0] < END_NS * 1e-9))
    if wrong.any():
        first = int(rows[wrong.argmax()])
        raise ConfigError(
            f"{table.path}: {time.column!r} of sample {first + 1} is {stamps[first, 0]:g} s; must "
            "be a time"
        )
    t_ns = np.rint(stamps[rows, 0] * 1e9).astype(np.int64)
    kept, text = judged(
        table.path, name, t_ns, values[rows], found.rates_hz, may_repeat=found.needed == SPEED
    )
    rows, t_ns = rows[kept], t_ns[kept]
    troubles += found.steps(needed[rows], t_ns)
    sizes = [
        f"{key} up to {np.nanmax(np.abs(part[rows])):.3g} {UNITS[key]}".rstrip()
        for key, part in found.parts.items()
        if np.isfinite(part[rows]).any()
    ]

    def write(writer: RecordingWriter) -> None:
        for time_ns, row in zip(t_ns.tolist(), rows.tolist(), strict=True):
            said = {key: found.words(part[row]) for key, part in found.parts.items()}
            known = {key: value for key, value in said.items() if value}
            writer.json(f"{SAMPLES}{name}", time_ns, known)

    return Channel(
        topic=f"{SAMPLES}{name}",
        source=table.path,
        t_ns=t_ns,
        text="; ".join([text, ", ".join(sizes), *troubles]),
        write=write,
    )
