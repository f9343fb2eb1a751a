"""Read columns of numbers by name from CSV with a header, NumPy .npz or ROS 2 bags."""

import csv
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from fsw.commands.importing.captures import read_text
from fsw.messages import FloatArray
from fsw.messages.errors import ConfigError, brief, cut, unforeseen

DELIMITERS = ",;\t"
BAG_FILES = (".mcap", ".db3", ".bag")
BAG_FOLDER = "metadata.yaml"  # is in every bag that is a folder
JOINT_STATE, IMU = "sensor_msgs/msg/JointState", "sensor_msgs/msg/Imu"
Columns: TypeAlias = Mapping[str, Sequence[str] | NDArray[np.generic]]
# what a damaged file can raise in the readers of NumPy and rosbags
_BROKEN = (
    OSError,
    ValueError,
    LookupError,
    EOFError,
    AssertionError,
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
)


class Table:
    """The columns of one file: .csv, .npz, or with any other suffix a ROS 2 bag.

    Raises
    ------
    ConfigError when the file cannot be read, is empty or cut off, or rosbags is not installed.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        reader = {".csv": _csv_columns, ".npz": _npz_columns}.get(path.suffix, _bag_columns)
        self._columns: Columns = reader(path)

    def column(self, name: str) -> FloatArray:
        """Return a column (k, m) of k rows; an empty cell is NaN.

        Raises
        ------
        ConfigError when no column has this name, or the column contains anything but numbers.
        """
        if name not in self._columns:
            close = get_close_matches(name, self._columns, n=1)
            hint = f"did you mean {close[0]!r}? " if close else ""
            found = cut(", ".join(self._columns) or "none")
            raise ConfigError(f"{self.path}: no column {name!r}; {hint}it has: {found}")
        held = self._columns[name]
        values = held if isinstance(held, np.ndarray) else self._numbers(name, held)
        if values.dtype.kind not in "fiu" or values.ndim not in (1, 2):
            words = f"holds {values.dtype} of shape {values.shape}"
            raise ConfigError(f"{self.path}: {name!r} {words}; must be numbers, a row a sample")
        return values.astype(np.float64).reshape(len(values), -1)

    def _numbers(self, name: str, cells: Sequence[str]) -> FloatArray:
        values = np.full(len(cells), np.nan)
        for row, cell in enumerate(cells):
            try:
                values[row] = float(cell) if cell.strip() else np.nan
            except ValueError as error:
                words = f"{name!r} is {brief(cell)}; must be a number"
                raise ConfigError(f"{self.path}: line {row + 2}: {words}") from error
        return values


def _csv_columns(path: Path) -> Columns:
    lines = read_text(path).splitlines()
    delimiter = max(DELIMITERS, key=lines[0].count)
    header = [name.strip() for name in lines[0].lstrip("#").split(delimiter)]
    rows = list(csv.reader(lines[1:], delimiter=delimiter))
    for number, row in enumerate(rows, 2):
        if len(row) != len(header):
            words = f"{len(row)} values for {len(header)} columns"
            raise ConfigError(f"{path}: line {number} has {words}")
    if not rows:
        raise ConfigError(f"{path}: is empty below its header")
    return dict(zip(header, zip(*rows, strict=True), strict=True))


def _npz_columns(path: Path) -> Columns:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as held:
            return {name: np.asarray(held[name]) for name in held.files}
    except _BROKEN as error:
        raise ConfigError(f"{path}: cannot be read as .npz: {unforeseen(error)}") from error


def _bag_columns(path: Path) -> Columns:
    """Return the columns, named TOPIC.FIELD, of all topics with joint states or inertial data."""
    if fault := _no_bag(path):
        raise ConfigError(f"{path}: cannot be read as a ROS 2 bag: {fault}")
    rows: dict[str, list[dict[str, float]]] = {}
    for topic, row in _bag_rows(path):
        rows.setdefault(topic, []).append(row)
    if not rows:
        raise ConfigError(f"{path}: holds no {JOINT_STATE} and no {IMU}")
    return {
        f"{topic}.{name}": np.array([row.get(name, np.nan) for row in own])
        for topic, own in rows.items()
        for name in dict.fromkeys(name for row in own for name in row)
    }


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


def _bag_rows(path: Path) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield topic and values by field of every message with joint states or inertial data."""
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        words = f"{path}: a ROS 2 bag needs {error.name}: pip install 'inertia-daemon[ros2]'"
        raise ConfigError(words) from error
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as bag:
            wanted = [c for c in bag.connections if c.msgtype in (JOINT_STATE, IMU)]
            for connection, received_ns, data in bag.messages(wanted) if wanted else ():
                message: Any = bag.deserialize(data, connection.msgtype)
                stamp = message.header.stamp
                row = {"stamp": stamp.sec + stamp.nanosec * 1e-9, "received": received_ns * 1e-9}
                if connection.msgtype == IMU:
                    for part in ("angular_velocity", "linear_acceleration"):
                        vector = getattr(message, part)
                        row |= {f"{part}.{axis}": getattr(vector, axis) for axis in "xyz"}
                else:
                    for part in ("position", "effort"):
                        pairs = zip(message.name, getattr(message, part), strict=False)
                        row |= {f"{part}.{name}": float(value) for name, value in pairs}
                yield connection.topic, row
    except (AnyReaderError, *_BROKEN) as error:
        raise ConfigError(f"{path}: cannot be read as a ROS 2 bag: {unforeseen(error)}") from error
