"""Turn mapped columns of a table into channels of decoded samples.

The recording contains the values that the sensors measured, in SI units. The replay applies
calibration and delays of the configuration, as the daemon does to received values.
"""

from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Self

import numpy as np

from fsw.config import Config
from fsw.config.constants import STANDARD_GRAVITY_M_S2
from fsw.drivers.sources.samples import (
    FORCE,
    FORCE_N,
    NORM_TOLERANCE,
    QUATERNION,
    RATE,
    SPEED,
    TORQUE,
)
from fsw.errors import ConfigError
from fsw.exchange.recording import END_NS, SAMPLES
from fsw.exchange.recording_writer import RecordingWriter
from fsw.messages import FloatArray
from offline.importing.captures import Channel
from offline.importing.joints import found_joints
from offline.importing.mapping import (
    FACTORS,
    Imu,
    Joints,
    Mapping,
    Source,
    StarTracker,
    TimeColumn,
    Wheels,
    WrenchSensors,
)
from offline.importing.poses import Held, standstills
from offline.importing.quantities import (
    Field,
    Found,
    by_name,
    by_sensor,
    listed,
    part_of,
    within,
)
from offline.importing.stamps import judged
from offline.importing.tables import Parts, Table
from offline.importing.usable import UNIT, usable

POSED = ("joints", "wrench_sensors")  # sections of a table of static poses


class _Section:
    """The tables of one section of a mapping, and its stamps."""

    def __init__(
        self, name: str, mapping: Mapping, source: Source, open_table: Callable[..., Parts]
    ) -> None:
        self.name = name
        self.time = mapping.time_of(name, source)
        self.source, self._open = source, open_table
        self.stamps_s, self.notes = self.table(None).column(self.time.column, self.time.unit)
        self.table(None).refuse_other_unit(f"{name}.time", self.time.column, self.time.unit)
        self.stamps_s = self.stamps_s * FACTORS[self.time.unit]
        self.count: int | None = len(self.stamps_s)

    def table(self, file: Path | None) -> Parts:
        """Return the table in `file`; None: the table of the section."""
        return self._open(self.name, self.source.file if file is None else (file,))


class _Poses(_Section):
    """Joints in a table of static poses: every row lasts for one window."""

    def __init__(
        self, config: Config, mapping: Mapping, joints: Joints, open_table: Callable[..., Parts]
    ) -> None:
        timed = [name for name in mapping.sections if name not in POSED]
        timed += [f"{name}.time" for name, own in mapping.sections.items() if own.time is not None]
        if timed:
            raise ConfigError(f"joints.poses: poses have no time; {timed[0]} must not be mapped")
        self.name, self.notes, self.time = "joints", [], TimeColumn(column="pose", unit="s")
        self.source, self._open, self._rows, self.count = joints, open_table, None, None
        order = joints.order or [joint.name for joint in config.joints]
        poses = part_of(self, "joints.position", joints.position, order).finite
        self._rows, self.stamps_s = standstills(config, poses)
        self.count = len(self.stamps_s)

    def of(self, name: str, source: Source) -> Self:
        """Return the section of another sensor at the same poses."""
        other = copy(self)
        other.name, other.source = name, source
        return other

    def table(self, file: Path | None) -> Parts:
        """Return the table with a row for every sample."""
        table = super().table(file)
        return table if self._rows is None else Held(table, self._rows)


def sampled_channels(
    config: Config, mapping: Mapping, folder: Path, file: Path | Table | None
) -> Iterator[Channel]:
    """Yield the channels that a mapping describes.

    Parameters
    ----------
    folder : folder of the mapping; paths of files in the mapping are relative to it
    file : file, or table in memory, of the sections that name no file

    Raises
    ------
    ConfigError when columns or stamps cannot be used, or belong to another robot.
    """
    tables: dict[Path, Table] = {}
    if isinstance(file, Table):
        tables[file.path] = file
        file = file.path

    def open_table(name: str, files: Sequence[Path] | None) -> Parts:
        paths = [file] if files is None else [folder / own for own in files]
        if not paths or None in paths:
            raise ConfigError(f"{name}.file: missing, and the command line has no FILE")
        for path in paths:
            if path is not None and path not in tables:
                tables[path] = Table(path)
        return Parts([tables[path] for path in paths if path is not None])

    poses: _Poses | None = None
    if mapping.joints is not None and mapping.joints.poses:
        poses = _Poses(config, mapping, mapping.joints, open_table)
    for name, source in mapping.sections.items():
        section = (
            _Section(name, mapping, source, open_table) if poses is None else poses.of(name, source)
        )
        found = FOUND[name](config, source, section)
        yield _channel(section, found if poses is None else replace(found, may_repeat=True))


def _wheels(config: Config, mapped: Wheels, section: _Section) -> Found:
    names = [wheel.name for wheel in config.wheels]
    sensing = [wheel.name for wheel in config.wheels if wheel.torque != "none"]
    if sensing:
        raise ConfigError(
            f"wheels: {' '.join(sensing)} have torque: measured in {config.name}, and no mapping "
            "holds it"
        )
    speed = part_of(section, "wheels.speed", mapped.speed, names)
    limits = [wheel.speed_limit_rad_s for wheel in config.wheels]
    values, troubles = within(section, speed, limits, "rad/s")
    return Found(
        fields={SPEED: Field(values=values, unit="rad/s", words=by_name(names))},
        needed=values,
        needs="every speed",
        rates_hz={f"wheels.{i}.rate_hz": wheel.rate_hz for i, wheel in enumerate(config.wheels)},
        troubles=troubles,
        may_repeat=True,
        columns=speed.columns,
        slots=names,
    )


def _wrench_sensors(config: Config, mapped: WrenchSensors, section: _Section) -> Found:
    sensors = config.wrench_sensors
    names = [sensor.name for sensor in sensors]
    slots = [f"{name}.{axis}" for name in names for axis in "xyz"]
    slots = list("xyz") if len(names) == 1 else slots
    force = part_of(section, "wrench_sensors.force", mapped.force, slots)
    torque = part_of(section, "wrench_sensors.torque", mapped.torque, slots)
    limits = [[limit for own in sensors for limit in own.limits[k : k + 3]] for k in (0, 3)]
    forces, troubles = within(section, force, limits[0], "N")
    torques, more = within(section, torque, limits[1], "N m")
    return Found(
        fields={
            FORCE_N: Field(values=forces, unit="N", words=by_sensor(names)),
            TORQUE: Field(values=torques, unit="N m", words=by_sensor(names)),
        },
        needed=np.concatenate([forces, torques], axis=1),
        needs="every axis",
        rates_hz={f"wrench_sensors.{i}.rate_hz": own.rate_hz for i, own in enumerate(sensors)},
        troubles=[*troubles, *more],
        columns=[*force.columns, *torque.columns],
        slots=[*(f"force.{slot}" for slot in slots), *(f"torque.{slot}" for slot in slots)],
    )


def _imu(config: Config, mapped: Imu, section: _Section) -> Found:
    rate = part_of(section, "imu.rate", mapped.rate, "xyz")
    values, troubles = within(section, rate, [config.imu.max_rate_rad_s] * 3, "rad/s")
    fields = {RATE: Field(values=values, unit="rad/s", words=listed)}
    if mapped.specific_force is not None:
        force = part_of(section, "imu.specific_force", mapped.specific_force, "xyz")
        limit = config.imu.acc_range_g * STANDARD_GRAVITY_M_S2
        values, more = within(section, force, [limit] * 3, "m/s2")
        fields[FORCE] = Field(values=values, unit="m/s2", words=listed)
        troubles += more
    rates_hz = {"imu.rate_hz": config.imu.rate_hz}
    return Found(
        fields=fields, needed=None, needs="any value", rates_hz=rates_hz, troubles=troubles
    )


def _star_tracker(config: Config, mapped: StarTracker, section: _Section) -> Found:
    q, tracker = mapped.quaternion, config.star_tracker
    part = part_of(section, "star_tracker.quaternion", q, q.order)
    length = np.hypot.reduce(part.finite, axis=1, keepdims=True)
    is_far = np.repeat(np.abs(length - 1.0) > NORM_TOLERANCE, len(q.order), axis=1)
    bounds = [f"of a quaternion that is not of length 1 within {NORM_TOLERANCE:g}"] * len(q.order)
    values, troubles = usable(section.table(None).path, part, is_far, bounds)
    values = values[:, [q.order.index(axis) for axis in "xyzw"]]
    return Found(
        fields={QUATERNION: Field(values=values, unit="", words=listed)},
        needed=values,
        needs="every component",
        rates_hz={} if tracker is None else {"star_tracker.rate_hz": tracker.rate_hz},
        troubles=troubles,
        columns=part.columns,
        slots="xyzw",
    )


FOUND: dict[str, Callable[..., Found]] = {
    "joints": found_joints,
    "wrench_sensors": _wrench_sensors,
    "wheels": _wheels,
    "imu": _imu,
    "star_tracker": _star_tracker,
}


def _channel(section: _Section, found: Found) -> Channel:
    """Return a channel of the usable rows in order of time."""
    table, stamps_s = section.table(None), section.stamps_s
    values = np.concatenate([own.values for own in found.fields.values()], axis=1)
    if stamps_s.shape[1] != 1:
        raise ConfigError(
            f"{table.path}: time column {section.time.column!r} has {stamps_s.shape[1]} values in "
            "a row; must have 1"
        )
    rows, troubles = _rows(section, found, values)
    t_ns = np.rint(stamps_s[rows, 0] * 1e9).astype(np.int64)
    kept, text = judged(
        table.path, section.name, t_ns, values[rows], found.rates_hz, may_repeat=found.may_repeat
    )
    rows, t_ns = rows[kept], t_ns[kept]
    sizes = [
        f"{key} up to {np.nanmax(np.abs(own.values[rows])):.3g} {own.unit}".rstrip()
        for key, own in found.fields.items()
        if np.isfinite(own.values[rows]).any()
    ]

    def write(writer: RecordingWriter) -> None:
        for time_ns, row in zip(t_ns.tolist(), rows.tolist(), strict=True):
            said = {key: own.words(own.values[row]) for key, own in found.fields.items()}
            known = {key: value for key, value in said.items() if value}
            writer.json(f"{SAMPLES}{section.name}", time_ns, known)

    notes = [*table.notes(section.time.column), *section.notes, *found.troubles, *troubles]
    return Channel(
        topic=f"{SAMPLES}{section.name}",
        source=table.path,
        t_ns=t_ns,
        text="; ".join([text, ", ".join(sizes), *_asked_once([*notes, *found.steps(rows, t_ns)])]),
        write=write,
    )


def _asked_once(notes: Sequence[str]) -> list[str]:
    """Return the notes with the question about the unit behind the last, not behind each."""
    told = [note.replace(f"; {UNIT}", "") for note in notes]
    return told if told == list(notes) else [*told, UNIT]


def _rows(section: _Section, found: Found, values: FloatArray) -> tuple[np.ndarray, list[str]]:
    """Return the rows that have what they need and a time, and a text about the others."""
    table, stamps_s = section.table(None), section.stamps_s[:, 0]
    is_whole = np.isfinite(values).any(axis=1)
    if found.needed is not None:
        is_whole = np.isfinite(found.needed).all(axis=1)
        if not is_whole.any():
            raise ConfigError(f"{table.path}: {section.name}: {_never_whole(table, found)}")
    has_time = ~np.isnan(stamps_s)
    if not has_time.any():
        raise ConfigError(f"{table.path}: {section.time.column!r} has no value")
    troubles = [
        f"rows without {what}, left out: {lost}"
        for what, lost in (
            (found.needs, int((~is_whole).sum())),
            ("a time", int((is_whole & ~has_time).sum())),
        )
        if lost
    ]
    rows = np.flatnonzero(is_whole & has_time)
    wrong = ~((stamps_s[rows] >= 0.0) & (stamps_s[rows] < END_NS * 1e-9))
    if wrong.any():
        first = int(rows[wrong.argmax()])
        raise ConfigError(
            f"{table.path}: {section.time.column!r} of sample {first + 1} is "
            f"{stamps_s[first]:g} s; must be a time"
        )
    return rows, troubles


def _never_whole(table: Parts, found: Found) -> str:
    """Return in words which columns no row holds together."""
    topic = f" of {found.columns[0].partition('.')[0]}" * (table.row == "message")
    words = f"no {table.row}{topic} holds all of {' '.join(found.slots)}"
    is_known = np.isfinite(np.asarray(found.needed))
    for k, slot in enumerate(found.slots):
        others = np.delete(is_known, k, axis=1)
        if not (is_known[:, k] & others.any(axis=1)).any():
            return f"{words}; {slot} comes alone"
    return f"{words}; {found.slots[0]} comes without {found.slots[-1]}"
