"""Positions and torques of all joints; forces and metres of those that are prismatic."""

from collections.abc import Sequence

import numpy as np

from fsw.config import Config, JointConfig
from fsw.drivers.sources.joint_calibration import Calibration
from fsw.drivers.sources.joint_track import SLACK_SIGMAS
from fsw.drivers.sources.samples import FORCE_N, POSITION, POSITION_M, TORQUE
from fsw.errors import ConfigError
from fsw.estimators.model.building import robot_of
from fsw.messages import FloatArray
from offline.importing.mapping import Angles, Joints, Quantity, Torques
from offline.importing.quantities import Field, Found, Section, by_name, part_of
from offline.importing.stamps import refuse_two_courses
from offline.importing.tables import Parts
from offline.importing.usable import UNIT, Part, jumps, usable
from offline.importing.wraps import unwrap

BEYOND_LIMITS = 2.0  # times the limit, which no joint reaches: degrees are 57 times as many
MOST_RAD = 1e6  # no encoder counts to larger angles or lengths
REVOLUTE, PRISMATIC = "revolute", "prismatic"
UNITS = {  # of positions and torques by kind of joint: those of a mapping, the first is SI
    (Angles, REVOLUTE): ("rad", "deg"),
    (Angles, PRISMATIC): ("m", "mm"),
    (Torques, REVOLUTE): ("N m", "mN m"),
    (Torques, PRISMATIC): ("N", "mN"),
}
KEYS = {
    (Angles, REVOLUTE): POSITION,
    (Angles, PRISMATIC): POSITION_M,
    (Torques, REVOLUTE): TORQUE,
    (Torques, PRISMATIC): FORCE_N,
}


def found_joints(config: Config, mapped: Joints, section: Section) -> Found:
    """Return positions and torques, with the lines on their rejected, wrapped and jumping values.

    Raises
    ------
    ConfigError when the mapping does not fit the robot.
    """
    order = _order(config, mapped)
    by_joint = {joint.name: joint for joint in config.joints}
    joints = [by_joint[name] for name in order]
    _refuse_units("joints.position", mapped.position, joints)
    path = section.table(None).path
    used = {joint.bus for joint in config.joints}
    buses = [(i, bus) for i, bus in enumerate(config.buses) if bus.name in used]
    rates_hz = {f"buses.{i}.rate_hz": bus.rate_hz for i, bus in buses}
    periods_s = {bus.name: 1.0 / bus.rate_hz for _, bus in buses}
    limits = np.array([joint.speed_limit_rad_s for joint in joints])
    noise = SLACK_SIGMAS * np.array([joint.position_noise_rad for joint in joints])
    slack = noise + limits * np.array([periods_s[joint.bus] for joint in joints])
    calibration, every = Calibration(joints, on_wire=False), np.arange(len(order))

    position = part_of(section, "joints.position", mapped.position, order)
    wrapped = _unwrapped(mapped.position, joints, position, section.stamps_s, limits, noise)
    angles, _ = calibration.apply(every, position.finite, np.zeros(len(order)))
    reach = limits * _lasted_s(section.stamps_s, len(angles), min(rates_hz.values())) + noise
    is_far = np.abs(angles - _middle(angles)) > reach
    speeds = [f"{joint.speed_limit_rad_s:g} {_si(Angles, joint)}/s" for joint in joints]
    bounds = [f"out of reach at {speed}" for speed in speeds]
    values, troubles = usable(path, position, is_far, bounds)
    near = np.where(is_far, np.nan, angles)
    troubles += _beyond_limits(config, position.columns, joints, near)
    fields, columns = _fields(Angles, joints, values), list(position.columns)
    kept = np.empty((len(values), 0))
    if mapped.torque is not None:
        _refuse_units("joints.torque", mapped.torque, joints)
        is_sensed = [joint.torque != "none" for joint in joints]
        torque = part_of(section, "joints.torque", mapped.torque, order, is_sensed)
        _, torques = calibration.apply(every, np.zeros(len(order)), torque.finite)
        is_far = np.abs(torques) > np.array([joint.torque_limit_nm for joint in joints])
        bounds = [f"beyond {joint.torque_limit_nm:g} {_si(Torques, joint)}" for joint in joints]
        kept, more = usable(path, torque, is_far, bounds)
        troubles += more
        columns = [*columns, *torque.columns]
        _refuse_apart(section.table(None), torque, values, kept)
        fields |= _fields(Torques, joints, kept)
        kept = np.where(torque.is_read, kept, np.nan)
        troubles += _constant(torque.columns, kept, [_si(Torques, joint) for joint in joints])
    refuse_two_courses(path, columns, np.hstack([values, kept]), section.stamps_s)
    units = [_si(Angles, joint) for joint in joints]
    return Found(
        fields=fields,
        needed=values,
        needs="every position",
        rates_hz=rates_hz,
        troubles=[*wrapped, *troubles],
        columns=position.columns,
        slots=order,
        steps=lambda rows, t_ns: jumps(position.columns, values[rows], t_ns, limits, slack, units),
    )


def _refuse_apart(table: Parts, torque: Part, positions: FloatArray, torques: FloatArray) -> None:
    """Raise ConfigError if no row that holds all positions holds the torque of a sensor."""
    is_whole = np.isfinite(positions).all(axis=1)
    is_lost = ~np.isfinite(torques[is_whole]).any(axis=0) & np.array(torque.is_read)
    if is_whole.any() and is_lost.any():
        column = torque.columns[int(is_lost.argmax())]
        raise ConfigError(
            f"{table.path}: joints.torque: no {table.row} holds {column} with all positions; "
            "join those of one time before the import"
        )


def _constant(columns: Sequence[str], values: FloatArray, units: Sequence[str]) -> list[str]:
    """Return a line for each column whose values are all one."""
    return [
        f"{column} is {known[0]:g} {unit} in every row: is it measured?"
        for column, own, unit in zip(columns, values.T, units, strict=True)
        if len(known := own[np.isfinite(own)]) > 1 and not np.ptp(known)
    ]


def _beyond_limits(
    config: Config, columns: Sequence[str], joints: Sequence[JointConfig], positions: FloatArray
) -> list[str]:
    """Return a line for each column with positions (k, width) far beyond the limits in the URDF."""
    model = robot_of(config).model
    lines, urdf = [], config.robot.urdf.name
    for column, joint, own in zip(columns, joints, positions.T, strict=True):
        place = model.joints[model.getJointId(joint.name)].idx_q
        low, high = model.lowerPositionLimit[place], model.upperPositionLimit[place]
        reach, most, unit = np.nanmax(np.abs(own), initial=0.0), max(-low, high), _si(Angles, joint)
        if 0.0 < most < reach / BEYOND_LIMITS:
            lines.append(
                f"{column} reaches {reach:.3g} {unit}, and the limits in {urdf} are {low:.3g} "
                f"to {high:.3g} {unit}; {UNIT}"
            )
    return lines


def _order(config: Config, mapped: Joints) -> list[str]:
    """Return the joints in the order of the columns. Raises ConfigError if they do not fit."""
    names = [joint.name for joint in config.joints]
    order = names if mapped.order is None else list(mapped.order)
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
    if mapped.torque is None and sensing:
        raise ConfigError(
            f"joints.torque: missing; {' '.join(sensing)} have torque sensors in {config.name}"
        )
    return order


def _si(kind: type[Quantity], joint: JointConfig) -> str:
    return UNITS[kind, joint.kind][0]


def _refuse_units(key: str, quantity: Angles | Torques, joints: Sequence[JointConfig]) -> None:
    """Raise ConfigError if a unit is not of its joint's kind."""
    units = quantity.units
    if len(units) not in (1, len(joints)):
        raise ConfigError(f"{key}.unit: {len(units)} values; must be 1 or {len(joints)}")
    own = units * len(joints) if len(units) == 1 else units
    for joint, unit in zip(joints, own, strict=True):
        fit = UNITS[type(quantity), joint.kind]
        if unit not in fit:
            example = ", ".join(_si(type(quantity), each) for each in joints)
            raise ConfigError(
                f"{key}.unit: {unit!r} for {joint.name}, which is {joint.kind}; must be "
                f"{fit[0]} or {fit[1]}: unit: [{example}]"
            )


def _unwrapped(
    quantity: Angles,
    joints: Sequence[JointConfig],
    part: Part,
    stamps_s: FloatArray,
    limits: FloatArray,
    noise: FloatArray,
) -> list[str]:
    """Unwrap the angles of revolute joints in place; return a line for each that wraps."""
    declared: Sequence[bool | None] = quantity.wraps or (None,)
    if len(declared) not in (1, len(joints)):
        words = f"{len(declared)} values; must be 1 or {len(joints)}"
        raise ConfigError(f"joints.position.wraps: {words}")
    own = list(declared) * len(joints) if len(declared) == 1 else list(declared)
    for k, joint in enumerate(joints):
        if joint.kind == PRISMATIC:
            if own[k]:
                raise ConfigError(
                    f"joints.position.wraps: {joint.name} is prismatic; must be false"
                )
            own[k] = False
    if len(part.values) != len(stamps_s):
        return []  # the caller compares the lengths
    values = np.where(np.abs(part.values) <= MOST_RAD, part.values, np.nan)
    counts = unwrap(values, stamps_s[:, 0], limits, noise, own)
    is_known = np.isfinite(values)
    part.values[is_known] = values[is_known]
    return [
        f"{column} wraps at 2 pi, unwrapped: {count}"
        for column, count in zip(part.columns, counts, strict=True)
        if count
    ]


def _fields(
    kind: type[Quantity], joints: Sequence[JointConfig], values: FloatArray
) -> dict[str, Field]:
    """Return the values of all joints by key of the message: revolute and prismatic ones."""
    fields = {}
    for joint_kind in (REVOLUTE, PRISMATIC):
        places = [k for k, joint in enumerate(joints) if joint.kind == joint_kind]
        if places:
            fields[KEYS[kind, joint_kind]] = Field(
                values=values[:, places],
                unit=UNITS[kind, joint_kind][0],
                words=by_name([joints[k].name for k in places]),
            )
    return fields


def _lasted_s(stamps_s: FloatArray, count: int, rate_hz: float) -> float:
    """Return the longer of the time between the stamps and that of the rows at a rate."""
    known_s = stamps_s[np.isfinite(stamps_s)]
    return max(count / rate_hz, float(np.ptp(known_s)) if known_s.size else 0.0)


def _middle(values: FloatArray) -> FloatArray:
    """Return each column's median (width,) [rad] of values up to MOST_RAD; 0 if there are none."""
    columns = [column[np.abs(column) <= MOST_RAD] for column in values.T]
    return np.array([np.median(column) if column.size else 0.0 for column in columns])
