"""Sampled data: mapped columns to decoded samples.

The recording holds the sensors' own values in SI units. Calibration and delays of the
configuration are applied when it is replayed, as to values from the wire.
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
from fsw.config import Config
from fsw.drivers.sources.samples import (
    FORCE,
    POSITION,
    QUATERNION,
    RATE,
    SPEED,
    TORQUE,
)
from fsw.exchange.recording import END_NS, SAMPLES
from fsw.exchange.recording_writer import RecordingWriter
from fsw.messages import FloatArray
from fsw.messages.errors import ConfigError

UNITS = {
    POSITION: "rad",
    TORQUE: "N m",
    RATE: "rad/s",
    FORCE: "m/s2",
    QUATERNION: "",
    SPEED: "rad/s",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Found:
    """One source's values in SI units."""

    parts: dict[str, FloatArray]  # (k, width) by key of its message; NaN: missing
    needed: str  # the part without which a row is none; empty: any will do
    words: Callable[[FloatArray], Any]  # values (width,) of a part as they stand in a message
    rates_hz: dict[str, float]  # declared, by key


def sampled_channels(
    config: Config, mapping: Mapping, folder: Path, file: Path | None
) -> Iterator[Channel]:
    """Yield the channels that a mapping describes.

    Parameters
    ----------
    folder : of the mapping, whose files are relative to it
    file : the one of sections that name none

    Raises
    ------
    ConfigError when columns or stamps cannot be used, or are those of another robot.
    """
    tables: dict[Path, Table] = {}

    def open_table(name: str, section: Source) -> Table:
        path = file if section.file is None else folder / section.file
        if path is None:
            raise ConfigError(f"{name}.file: missing, and the command line has no FILE")
        tables[path] = tables[path] if path in tables else Table(path)
        return tables[path]

    for name, section in mapping.sections.items():
        table = open_table(name, section)
        if isinstance(section, Joints):
            found = _joints(config, section, table)
        elif isinstance(section, Wheels):
            found = _wheels(config, section, table)
        elif isinstance(section, Imu):
            found = _imu(config, section, table)
        else:
            found = _star_tracker(config, section, table)
        yield _channel(name, table, mapping.time_of(name, section), found)


def _joints(config: Config, section: Joints, table: Table) -> _Found:
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
    parts = {POSITION: _matrix(table, "joints.position", section.position, order)}
    if section.torque is not None:
        parts[TORQUE] = _matrix(table, "joints.torque", section.torque, order)
    used = {joint.bus for joint in config.joints}
    buses = [(i, bus) for i, bus in enumerate(config.buses) if bus.name in used]
    rates_hz = {f"buses.{i}.rate_hz": bus.rate_hz for i, bus in buses}
    return _Found(parts=parts, needed=POSITION, words=_by_name(order), rates_hz=rates_hz)


def _wheels(config: Config, section: Wheels, table: Table) -> _Found:
    names = [wheel.name for wheel in config.wheels]
    sensing = [wheel.name for wheel in config.wheels if wheel.torque != "none"]
    if sensing:
        raise ConfigError(
            f"wheels: {' '.join(sensing)} have torque: measured in {config.name}, and no mapping "
            "holds it"
        )
    parts = {SPEED: _matrix(table, "wheels.speed", section.speed, names)}
    rates_hz = {f"wheels.{i}.rate_hz": wheel.rate_hz for i, wheel in enumerate(config.wheels)}
    return _Found(parts=parts, needed=SPEED, words=_by_name(names), rates_hz=rates_hz)


def _imu(config: Config, section: Imu, table: Table) -> _Found:
    parts = {RATE: _matrix(table, "imu.rate", section.rate, "xyz")}
    if section.specific_force is not None:
        parts[FORCE] = _matrix(table, "imu.specific_force", section.specific_force, "xyz")
    rates_hz = {"imu.rate_hz": config.imu.rate_hz}
    return _Found(parts=parts, needed="", words=_listed, rates_hz=rates_hz)


def _star_tracker(config: Config, section: StarTracker, table: Table) -> _Found:
    q, tracker = section.quaternion, config.star_tracker
    values = _matrix(table, "star_tracker.quaternion", q, q.order)
    values = values[:, [q.order.index(axis) for axis in "xyzw"]]
    rates_hz = {} if tracker is None else {"star_tracker.rate_hz": tracker.rate_hz}
    return _Found(parts={QUATERNION: values}, needed=QUATERNION, words=_listed, rates_hz=rates_hz)


def _by_name(names: Sequence[str]) -> Callable[[FloatArray], dict[str, float]]:
    """Return a function that gives the finite values of a row by name."""

    def words(values: FloatArray) -> dict[str, float]:
        finite = np.isfinite(values).tolist()
        rows = zip(names, values.tolist(), finite, strict=True)
        return {name: value for name, value, is_known in rows if is_known}

    return words


def _listed(values: FloatArray) -> list[float]:
    known: list[float] = values.tolist() if np.isfinite(values).all() else []
    return known


def _matrix(table: Table, key: str, quantity: Quantity, slots: Sequence[str]) -> FloatArray:
    """Return the columns of a quantity (k, len(slots)) in SI units, sign and scale applied."""
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
    scaled: FloatArray = values * factor
    return scaled


def _channel(name: str, table: Table, time: TimeColumn, found: _Found) -> Channel:
    """Return the rows that can be used, in order of time."""
    stamps = table.column(time.column) * FACTORS[time.unit]
    values = np.concatenate(list(found.parts.values()), axis=1)
    if len(stamps) != len(values) or stamps.shape[1] != 1:
        raise ConfigError(
            f"{table.path}: time column {time.column!r} has {len(stamps)} rows of "
            f"{stamps.shape[1]}; must be {len(values)} of 1, as {name}"
        )
    needed = found.parts[found.needed] if found.needed else values
    is_known = np.isfinite(needed)
    rows = np.flatnonzero(is_known.all(axis=1) if found.needed else is_known.any(axis=1))
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
        text=f"{text}; {', '.join(sizes)}",
        write=write,
    )
