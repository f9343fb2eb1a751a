"""Read ROS 2 bags: values by topic, field and joint, and why some are missing."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from file_delivery.extras import needs
from fsw.errors import ConfigError, unforeseen
from offline.importing.columns import Columns

BAG_FILES = (".mcap", ".db3", ".bag")
CURES = {  # of a bag that was cut off
    ".mcap": "; if it was cut off, recover what is there: mcap recover",
    ".bag": "; if it was cut off: rosbag reindex",
}
BAG_FOLDER = "metadata.yaml"  # is in every bag that is a folder
JOINT_STATE, IMU = "sensor_msgs/msg/JointState", "sensor_msgs/msg/Imu"
WRENCH = "geometry_msgs/msg/WrenchStamped"
_PARTS = ("position", "effort")
_VECTORS = {IMU: ("angular_velocity", "linear_acceleration"), WRENCH: ("force", "torque")}


@dataclass(frozen=True, slots=True)
class _Message:
    """Names and values of each part of a message; names are joints or axes."""

    topic: str
    stamp_s: float  # 0: none was given
    received_s: float
    parts: Mapping[str, tuple[Sequence[str], Sequence[float]]]


@dataclass(slots=True)
class _Topic:
    """Values of one topic, a dictionary by column for a message, and faults of its messages."""

    rows: list[dict[str, float]] = field(default_factory=list)
    faults: dict[str, Counter[str]] = field(default_factory=dict)  # by part
    unstamped: int = 0

    def add(self, message: _Message) -> None:
        """Keep the values of a message; those that belong to no joint for certain are counted."""
        row = {"received": message.received_s}
        if message.stamp_s:
            row["stamp"] = message.stamp_s
        else:
            self.unstamped += 1
        for part, (names, values) in message.parts.items():
            if fault := _fault(names, values):
                self.faults.setdefault(part, Counter())[fault] += 1
                continue
            pairs = zip(names, values, strict=True)
            row |= {f"{part}.{name}": float(value) for name, value in pairs}
        self.rows.append(row)


def _fault(names: Sequence[str], values: Sequence[float]) -> str:
    """Return why the values belong to no joint for certain; empty: they do."""
    if not len(values):
        return "is empty"
    if len(values) != len(names):
        return f"has {len(values)} values for {len(names)} names"
    return "names a joint twice" if len(set(names)) < len(names) else ""


def bag_columns(path: Path) -> Columns:
    """Return the columns, named TOPIC.FIELD, of topics with joint states, inertial data, wrenches.

    Raises
    ------
    ConfigError when the bag cannot be read or has no such topic, or rosbags is not installed.
    """
    if fault := _no_bag(path):
        raise ConfigError(f"{path}: cannot be read as a ROS 2 bag: {fault}")
    topics: dict[str, _Topic] = {}
    for message in _messages(path):
        topics.setdefault(message.topic, _Topic()).add(message)
    if not topics:
        raise ConfigError(f"{path}: holds no {JOINT_STATE}, {IMU} or {WRENCH}")
    values, absent, notes = {}, {}, {}
    for name, topic in topics.items():
        fields = dict.fromkeys(key for row in topic.rows for key in row)
        for key in fields:
            values[f"{name}.{key}"] = np.array([row.get(key, np.nan) for row in topic.rows])
        if topic.unstamped == len(topic.rows):
            absent[f"{name}.stamp"] = f"all stamps of {name} are 0; use {name}.received"
        for part, faults in topic.faults.items():
            if faults.total() == len(topic.rows):
                absent[f"{name}.{part}"] = _everywhere(name, part, faults)
        notes[name] = [
            f"{part} {fault}, not read: {count} messages"
            for part, faults in topic.faults.items()
            for fault, count in faults.items()
            if fault != "is empty"
        ]
    return Columns(values=values, rows="message", absent=absent, notes=notes)


def _everywhere(topic: str, part: str, faults: Counter[str]) -> str:
    if len(faults) == 1:
        return f"{part} {next(iter(faults))} in every message of {topic}"
    several = sorted(faults.items(), key=lambda item: (item[0] != "is empty", -item[1]))
    words = " and ".join(f"{fault} in {count}" for fault, count in several[:3])
    return f"{part} {words} messages of {topic}"


def _no_bag(path: Path) -> str:
    """Return the reason why a path cannot be a bag; empty: it may be one."""
    if path.is_dir():
        return "" if (path / BAG_FOLDER).exists() else f"the folder has no {BAG_FOLDER}"
    if not path.exists():
        return "no such file or folder"
    kinds = "a table .csv or .npz, a bag's folder or its .mcap"
    if path.suffix in BAG_FILES:
        return ""
    return f"{path.suffix or path.name} is not supported; FILE: {kinds}"


def _messages(path: Path) -> Iterator[_Message]:
    """Yield the messages with joint states, inertial data or wrenches."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        words = needs("a ROS 2 bag", str(error.name), "ros2")
        raise ConfigError(f"{path}: {words}") from error
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as bag:
            wanted = [c for c in bag.connections if c.msgtype in (JOINT_STATE, *_VECTORS)]
            for connection, received_ns, data in bag.messages(wanted) if wanted else ():
                message: Any = bag.deserialize(data, connection.msgtype)
                stamp = message.header.stamp
                stamp_s = stamp.sec + stamp.nanosec * 1e-9
                if connection.msgtype in _VECTORS:
                    held = message.wrench if connection.msgtype == WRENCH else message
                    names = _VECTORS[connection.msgtype]
                    vectors = {part: getattr(held, part) for part in names}
                    parts = {part: ("xyz", (v.x, v.y, v.z)) for part, v in vectors.items()}
                else:
                    parts = {part: (message.name, getattr(message, part)) for part in _PARTS}
                yield _Message(connection.topic, stamp_s, received_ns * 1e-9, parts)
    except Exception as error:  # the errors of rosbags and its parsers have no common base
        cure = CURES.get(path.suffix, "")
        words = f"cannot be read as a ROS 2 bag: {unforeseen(error).rstrip('.')}{cure}"
        raise ConfigError(f"{path}: {words}") from error
