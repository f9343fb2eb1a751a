"""Find the columns of joints and sensors in a table by their names."""

import re
from collections.abc import Sequence
from dataclasses import dataclass


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


TORQUE = _words("torque torques tau tauj effort eff trq tq moment")
CURRENT = _words("iq current currents")
SPEED = _words("velocity velocities vel qd dq dqj qdot speed")
OTHER = _words("acceleration accelerations qdd ddq current currents i temperature temp")
ANGLE = _words("position positions pos angle angles theta")
POSITION = ANGLE | _words("q joint joints j")
GYRO = _words("gyro gyr gyroscope angular omega rate w g angvel")
FORCE = _words("acc accel accelerometer linear force specific a f")
TURN = _words("quaternion quat q orientation attitude")
TIME = _words("time times t stamp timestamp timestamps sec seconds clock received")
PLANNED = _words("target cmd command commanded des desired ref reference goal d")
WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")
NUMBER = re.compile(r"\d+")
AXIS = re.compile(r"[wxyzWXYZ](?=[^A-Za-z]*$)")


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """Columns of one quantity, in the order of the joints or axes."""

    stem: str  # the name with {} in place of joint, number or axis
    columns: tuple[str, ...]

    @property
    def words(self) -> tuple[str, ...]:
        """The words of the stem in small letters."""
        return words_of(self.stem)


def words_of(name: str) -> tuple[str, ...]:
    """Return the words of a column's name in small letters."""
    return tuple(word.lower() for word in WORD.findall(name))


def joint_groups(
    columns: Sequence[str], joints: Sequence[str], *, spare: bool = False
) -> list[Group]:
    """Return the groups with a column for every joint, by the joints' names or by numbers.

    `spare`: a group may have more numbers than there are joints, and begins with the lowest one.
    """
    by_name, by_number = _by_stem(columns, joints)
    groups = [
        Group(stem=stem, columns=tuple(held[joint] for joint in joints))
        for stem, held in by_name.items()
        if set(held) == set(joints)
    ]
    taken = {column for group in groups for column in group.columns}
    groups += [
        Group(stem=stem, columns=tuple(held[number] for number in sorted(held)[: len(joints)]))
        for stem, held in by_number.items()
        if len(joints) <= len(held) <= (len(columns) if spare else len(joints))
        if not taken & set(held.values())
    ]
    return groups


def gaps(columns: Sequence[str], joints: Sequence[str]) -> list[str]:
    """Return a text for each stem that more than half of the joints have, but not all."""
    by_name, by_number = _by_stem(columns, joints)
    named = [
        f"{stem}: none of {', '.join(joint for joint in joints if joint not in held)}"
        for stem, held in by_name.items()
        if len(joints) < 2 * len(held) < 2 * len(joints)
    ]
    return named or [
        f"{stem}: {len(held)} for {len(joints)} joints"
        for stem, held in by_number.items()
        if len(joints) < 2 * len(held) < 2 * len(joints)
    ]


def _by_stem(
    columns: Sequence[str], joints: Sequence[str]
) -> tuple[dict[str, dict[str, str]], dict[str, dict[int, str]]]:
    """Return the columns of each stem by joint, and those by number."""
    by_name: dict[str, dict[str, str]] = {}
    by_number: dict[str, dict[int, str]] = {}
    for column in columns:
        named = [joint for joint in joints if _holds(column, joint)]
        if named:
            joint = max(named, key=len)
            stem = re.sub(re.escape(joint), "{}", column, flags=re.IGNORECASE)
            by_name.setdefault(stem, {})[joint] = column
        for number in dict.fromkeys(NUMBER.findall(column)):
            stem = re.sub(rf"(?<!\d){number}(?!\d)", "{}", column)
            by_number.setdefault(stem, {})[int(number)] = column
    return by_name, by_number


def axis_groups(columns: Sequence[str], axes: str) -> list[Group]:
    """Return the groups with a column for each of `axes`, such as `xyz`."""
    held: dict[str, dict[str, str]] = {}
    for column in columns:
        if found := AXIS.search(column):
            stem = f"{column[: found.start()]}{{}}{column[found.end() :]}"
            held.setdefault(stem, {})[found.group().lower()] = column
    return [
        Group(stem=stem, columns=tuple(own[axis] for axis in axes))
        for stem, own in held.items()
        if set(own) == set(axes)
    ]


def chosen(
    groups: Sequence[Group], wanted: frozenset[str], other: frozenset[str] = frozenset()
) -> Group | None:
    """Return the group whose stem has a wanted word and none of `other`.

    Measured quantities are preferred to planned ones.
    """
    fits = [g for g in groups if wanted & set(g.words) and not other & set(g.words)]
    return min(fits, key=lambda group: bool(PLANNED & set(group.words)), default=None)


def positions_and_torques(groups: Sequence[Group]) -> tuple[Group | None, Group | None]:
    """Return the groups of the joints' positions and torques, None for one not found.

    Currents stand for torques that are not there.
    """
    torque = chosen(groups, TORQUE, SPEED | OTHER)
    torque = torque or chosen(groups, CURRENT, ANGLE | SPEED | (OTHER - CURRENT))
    position = chosen(groups, POSITION, TORQUE | SPEED | OTHER)
    bare = [group for group in groups if group.stem == "{}"]  # named as the joints themselves
    return position or next(iter(bare), None), torque


def times(columns: Sequence[str], near: str) -> list[str]:
    """Return the columns that may be times, most probable first; `near`: a column they go with."""
    fits = [column for column in columns if TIME & set(words_of(column))]
    topic = near.partition(".")[0] if near.startswith("/") else ""
    return sorted(fits, key=lambda column: (not column.startswith(topic), "stamp" not in column))


def _holds(column: str, joint: str) -> bool:
    """Return whether a name holds that of a joint, and not of another that begins or ends so."""
    before, found, after = column.casefold().partition(joint.casefold())
    return bool(found) and not (before[-1:].isalnum() or after[:1].isdigit())
