"""Read what a recording tells `fsw init`: rates, columns, units, limits and noise.

Units are guessed from names and sizes. Whoever reads the mapping must check them.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fsw.config.constants import STANDARD_GRAVITY_M_S2
from fsw.drivers.codecs.canopen import COB_SYNC, COB_TPDO1, NODE_MASK
from fsw.drivers.wire import EFF_MASK, FrameArray
from fsw.errors import ConfigError, cut
from fsw.estimators.model.robot import RobotModel
from fsw.messages import FloatArray
from offline.can_logs.reading import read_can_log
from offline.checks.wiring import frame_rate_hz
from offline.importing.tables import ISO, Table
from offline.init.columns import (
    FORCE,
    GYRO,
    TORQUE,
    TURN,
    Group,
    axis_groups,
    chosen,
    gaps,
    joint_groups,
    positions_and_torques,
    times,
    words_of,
)
from offline.init.noise import (
    LEAST,
    Limits,
    most,
    noise_of,
    noise_of_turns,
    rate_of,
    sizes_of,
)

LOGS = (".log", ".blf", ".asc", ".trc")  # of a CAN bus; any other file is a table
UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
PERIODS_S = (2e-4, 0.2)  # a sensor's period in seconds; in another unit it is another number
TURN_RAD = 2.2 * np.pi  # larger angles of a joint with a range are degrees
RATE_HZ = 250.0  # of the joints, without a flag and without a recording
FAST_RAD_S = 15.0  # larger rates of a base are degrees a second


@dataclass(frozen=True, slots=True, kw_only=True)
class Wires:
    """Lines of a configuration for joints on devices whose frames a description defines."""

    name: str  # of the bus
    bus: Sequence[str]  # its other lines
    joints: Sequence[Sequence[str]]  # lines of each joint


@dataclass(frozen=True, slots=True, kw_only=True)
class Recorded:
    """What a recording, or a description of the devices, shows of the robot."""

    rate_hz: float  # of the joints
    imu_rate_hz: float = 0.0  # 0: no inertial unit
    tracker_rate_hz: float = 0.0  # 0: no star tracker
    has_torque: bool = True
    is_current: bool = False  # the torque is computed from the motor's current
    joints: Sequence[Limits] = ()  # in the order of the model
    gyro_noise_rad_s: float = 0.0  # 1 sigma of a sample; 0: not seen; likewise the next two
    acc_noise_m_s2: float = 0.0
    turn_noise_rad: float = 0.0
    nodes: Sequence[int] = ()  # of a CAN log of tailored nodes
    wires: Wires | None = None  # of other devices
    mapping: list[str] = field(default_factory=list)  # lines of the mapping of a table

    @property
    def is_table(self) -> bool:
        """Return whether the values are decoded already."""
        return not self.nodes and self.wires is None


def recorded(path: Path, model: RobotModel) -> Recorded:
    """Return what a table (CSV, .npz, bag) or CAN log says about the joints of a robot.

    Raises
    ------
    ConfigError when it cannot be read, or joints or times are not found in it.
    """
    if path.suffix.lower() in LOGS:
        return _of_log(path, model)
    return _of_table(Table(path), model)


def _of_log(path: Path, model: RobotModel) -> Recorded:
    frames = read_can_log(path).frames
    sync = frames["t_ns"][frames["word"] == COB_SYNC]
    words = {int(word) for word in np.unique(frames["word"])}
    nodes = sorted(w & NODE_MASK for w in words if COB_TPDO1 < w <= COB_TPDO1 | NODE_MASK)
    if len(sync) < LEAST or len(nodes) < model.n:
        held = ", ".join(f"0x{node:02x}" for node in nodes) or "none"
        raise ConfigError(
            f"--recording {path}: {len(sync)} SYNC frames (0x080) and {len(nodes)} nodes that send "
            f"TPDO1 ({held}); the robot has {model.n} joints. Other devices need --bus or --eds. "
            f"Frames: {cut('; '.join(_in_words(frames, word) for word in sorted(words)))}"
        )
    return Recorded(rate_hz=rate_of(sync * 1e-9), nodes=nodes[: model.n])


def _in_words(frames: FrameArray, word: int) -> str:
    """Return identifier, rate, length and the bytes that change of the frames of one kind."""
    own = frames[frames["word"] == word]
    length = int(own["length"].min())
    moving = np.flatnonzero(np.ptp(own["data"][:, :length], axis=0)).tolist()
    runs = np.split(moving, np.flatnonzero(np.diff(moving) > 1) + 1) if moving else []
    places = " ".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs)
    rate_hz = frame_rate_hz(own["t_ns"])
    return (
        f"0x{word & EFF_MASK:x} {rate_hz:.3g} Hz {length} bytes, of which {places or 'none'} move"
    )


def _of_table(table: Table, model: RobotModel) -> Recorded:
    names = list(table.names)
    arrays = [
        Group(stem=name, columns=(name,))
        for name in names
        if table.width(name) == model.n and model.n > 1
    ]
    position, torque = positions_and_torques([*arrays, *joint_groups(names, model.joint_names)])
    if position is None:
        raise ConfigError(
            f"--recording {table.path}: no {model.n} columns for the positions of "
            f"{cut(', '.join(model.joint_names))}; "
            + "".join(f"{words}; " for words in gaps(names, model.joint_names))
            + f"it has: {table.described()}"
        )
    column, unit, t_s = _time(table, position)
    q, q_unit = _angles(table, position, model)
    lines = [f"time: {{column: {_quoted(column)}, unit: {unit}}}  # CHECK", "joints:"]
    lines.append(f"  order: {_listed(model.joint_names)}  # CHECK as the columns come")
    lines.append(_line("position", position, q_unit, q, "rad"))
    tau, is_current = None, torque is not None and not TORQUE & set(torque.words)
    if torque is not None:
        tau, tau_unit = _torques(table, torque, model)
        if len(tau) != len(q):
            raise ConfigError(
                f"--recording {table.path}: {torque.columns[0]!r} has {len(tau)} rows; must be "
                f"{len(q)}, as {position.columns[0]!r}"
            )
        line = _line("torque", torque, tau_unit, tau, "A" if is_current else "N m")
        gains = f", scale: {[1.0] * model.n}}}  # CHECK N m per A at the joint, gear included;"
        lines.append(line.replace("}  # CHECK", gains) if is_current else line)
    rest = [
        name for name in names if name not in {*position.columns, *(torque or position).columns}
    ]
    others, seen = _sensors(table, rest, column)
    return Recorded(
        rate_hz=rate_of(t_s),
        has_torque=tau is not None,
        is_current=is_current,
        joints=sizes_of(t_s, q, tau, model.kinds()),
        mapping=[*lines, *others],
        **seen,
    )


def _sensors(
    table: Table, names: Sequence[str], time_of_joints: str
) -> tuple[list[str], dict[str, Any]]:
    """Return the lines of inertial unit and star tracker, and their fields of `Recorded`."""
    lines, seen = list[str](), dict[str, Any]()
    turns = chosen(axis_groups(names, "xyzw"), TURN)
    axes = axis_groups([n for n in names if turns is None or n not in turns.columns], "xyz")
    gyro, force = chosen(axes, GYRO, FORCE), chosen(axes, FORCE, GYRO)
    if gyro is not None:
        w = _values(table, gyro)
        said = _said(table, gyro)
        in_degrees = "deg" in gyro.stem.lower() or (most(w) > FAST_RAD_S and not said)
        in_degrees |= "deg/s" in said
        column, unit, t_s = _time(table, gyro)
        seen["imu_rate_hz"] = rate_of(t_s)
        seen["gyro_noise_rad_s"] = noise_of(t_s, np.deg2rad(w) if in_degrees else w)
        lines += ["imu:", *_own_time(column, unit, time_of_joints)]
        lines.append(_line("rate", gyro, "deg/s" if in_degrees else "rad/s", w, ""))
        if force is not None:
            f = _values(table, force)
            size = float(np.nanmedian(np.linalg.norm(f, axis=1)))
            said = _said(table, force)
            in_g = "g" in said or (0.8 < size < 1.2 and not said)
            seen["acc_noise_m_s2"] = noise_of(t_s, f) * (STANDARD_GRAVITY_M_S2 if in_g else 1.0)
            lines.append(_line("specific_force", force, "g" if in_g else "m/s2", f, ""))
    if turns is not None:
        column, unit, t_s = _time(table, turns)
        seen["tracker_rate_hz"] = rate_of(t_s)
        seen["turn_noise_rad"] = noise_of_turns(t_s, _values(table, turns))
        lines += ["star_tracker:", *_own_time(column, unit, time_of_joints)]
        columns = _listed(turns.columns)
        lines.append(f"  quaternion: {{columns: {columns}, order: xyzw}}  # CHECK")
    return lines, seen


def _own_time(column: str, unit: str, time_of_joints: str) -> list[str]:
    if column == time_of_joints:
        return []
    return [f"  time: {{column: {_quoted(column)}, unit: {unit}}}  # CHECK"]


def _time(table: Table, group: Group) -> tuple[str, str, FloatArray]:
    """Return column and unit of a group's stamps, and the stamps [s], NaN where a value lacks."""
    values, faults = _values(table, group), list[str]()
    rows, is_whole = len(values), np.isfinite(values).all(axis=1)
    for column in times(table.names, group.columns[0]):
        if table.width(column) != 1:
            continue
        t, unit = _stamps(table, column, faults)
        if len(t) != rows:
            continue
        t = np.where(is_whole, t, np.nan)
        steps = np.diff(np.unique(t[np.isfinite(t)]))
        if len(steps) < LEAST:
            found, least = f"{column!r} has {len(steps) + 1}", f"; at least {LEAST + 1} are needed"
            few = f" different values in {rows} rows; are these whole seconds?"
            faults.append(f"{found}{few if rows > LEAST else f' rows{least}'}")
            continue
        period = float(np.median(steps))
        fits = [u for u, s in UNITS_S.items() if PERIODS_S[0] <= period * s < PERIODS_S[1]]
        if not fits:
            words = f"must be {PERIODS_S[0]:g} to {PERIODS_S[1]:g} s, in s, ms, us or ns"
            faults.append(f"{column!r} goes in steps of {period:.3g}; {words}")
            continue
        if unit != ISO:
            said = {*words_of(column)[1:], table.unit(column)}
            named = (u for u in UNITS_S if u in said and u in fits)
            unit = next(named, fits[0])
        return column, unit, t * UNITS_S.get(unit, 1.0)
    raise ConfigError(
        f"--recording {table.path}: no times for {group.columns[0]!r}: "
        f"{'; '.join(faults) or 'no column is named as a time (t, time, stamp)'}; it has: "
        f"{table.described()}"
    )


def _stamps(table: Table, column: str, faults: list[str]) -> tuple[FloatArray, str]:
    """Return a column of times (k,), and its unit if it has dates; then the times are seconds.

    No times come from a column that has neither numbers nor dates; `faults` gets the reason.
    """
    with suppress(ConfigError):
        return table.column(column)[0][:, 0], ""
    try:
        return table.column(column, ISO)[0][:, 0], ISO
    except ConfigError as error:
        faults.append(str(error).removeprefix(f"{table.path}: "))
    return np.empty(0), ""


def _angles(table: Table, group: Group, model: RobotModel) -> tuple[FloatArray, str]:
    """Return the joints' positions [rad or m] and their unit in the table."""
    q, kinds = _values(table, group), model.kinds()
    turning = np.array([kind == "revolute" for kind in kinds])
    upper = np.array(model.model.upperPositionLimit[7:])
    lower = np.array(model.model.lowerPositionLimit[7:])
    is_ranged = turning & np.isfinite(upper - lower)
    beyond = is_ranged & (np.array([most(own) for own in q.T]) > TURN_RAD)
    said = _said(table, group)
    in_degrees = "deg" in {*words_of(group.stem), *said} or bool(beyond.any() and not said)
    if in_degrees:
        q = np.where(turning, np.deg2rad(q), q)
    unit = "deg" if in_degrees else "rad"
    if turning.all():
        return q, unit
    return q, f"[{', '.join(unit if kind == 'revolute' else 'm' for kind in kinds)}]"


def _torques(table: Table, group: Group, model: RobotModel) -> tuple[FloatArray, str]:
    """Return the joints' torques [N m or N] and their unit in the table."""
    tau = _values(table, group)
    said = {*words_of(group.stem), *_said(table, group)}
    unit = "mN m" if {"mnm", "mn", "mN m", "mN"} & said else "N m"
    slides = [kind == "prismatic" for kind in model.kinds()]
    words = unit
    if any(slides):
        words = f"[{', '.join(unit.removesuffix(' m') if slide else unit for slide in slides)}]"
    return tau * (1e-3 if unit == "mN m" else 1.0), words


def _said(table: Table, group: Group) -> set[str]:
    """Return what a row of units says of the columns."""
    return {table.unit(name) for name in group.columns} - {""}


def _values(table: Table, group: Group) -> FloatArray:
    return np.concatenate([table.column(name)[0] for name in group.columns], axis=1)


def _line(key: str, group: Group, unit: str, values: FloatArray, shown: str) -> str:
    columns = _quoted(group.columns[0]) if len(group.columns) == 1 else _listed(group.columns)
    size = f" largest {most(values):.3g} {shown}" if shown else ""
    return f"  {key}: {{columns: {columns}, unit: {unit}}}  # CHECK{size}"


def _quoted(text: str) -> str:
    """Return a name as a YAML scalar that may stand in a flow mapping."""
    return yaml.safe_dump([text], width=np.inf, default_flow_style=True).strip()[1:-1]


def _listed(names: Sequence[str]) -> str:
    return f"[{', '.join(map(_quoted, names))}]"
