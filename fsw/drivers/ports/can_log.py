"""Frames of CAN logs from other tools, in any format that python-can reads (candump, BLF, ASC)."""

import struct
import zlib
from pathlib import Path

import can

from fsw.drivers.wire import (
    EFF_FLAG,
    ERR_FLAG,
    MAX_DATA_BYTES,
    RTR_FLAG,
    FrameArray,
    flags_of,
    row_of,
    rows_of,
)
from fsw.messages.errors import ConfigError, unforeseen

TEXT_LOGS = (".asc", ".csv", ".log", ".trc")
MICROSECOND_NS = 1000  # resolution of a float of seconds since 1970, and of these logs
END_S = 2.0**33  # a stamp from here on is invalid
# errors that python-can's readers raise for a damaged log
_BROKEN = (
    can.CanError,
    can.io.blf.BLFParseError,
    OSError,
    ValueError,
    LookupError,
    TypeError,
    AssertionError,
    EOFError,
    ImportError,
    struct.error,
    zlib.error,
)


def message_row(t_ns: int, message: can.Message) -> bytes:
    """Return a python-can message as the bytes of one `FRAME`."""
    word = message.arbitration_id
    word |= EFF_FLAG * message.is_extended_id | RTR_FLAG * message.is_remote_frame
    word |= ERR_FLAG * message.is_error_frame
    flags = flags_of(is_fd=message.is_fd, bitrate_switch=message.bitrate_switch)
    return row_of(t_ns, word, bytes(message.data), flags)


def read_can_log(path: Path, channel: str | None = None) -> FrameArray:
    """Return the frames of a log in the log's order and with the log's stamps.

    Parameters
    ----------
    channel : one of the log's channels, as python-can names it; None: the log has only one

    Raises
    ------
    ConfigError when the log cannot be read, is cut off, or has no frame or not this channel.
    """
    rows: dict[str | None, list[bytes]] = {}
    try:
        _refuse_cut(path)
        reader = can.LogReader(path, **_options(path))
        written = getattr(reader, "file_size", path.stat().st_size)
        with reader:
            for message in reader:
                if not 0.0 <= message.timestamp < END_S:
                    raise ValueError(f"a frame at {message.timestamp:g} s")
                if len(message.data) > MAX_DATA_BYTES:
                    raise ValueError(f"a frame of {len(message.data)} bytes")
                t_ns = round(message.timestamp * 1e6) * MICROSECOND_NS
                name = None if message.channel is None else str(message.channel)
                rows.setdefault(name, []).append(message_row(t_ns, message))
    except _BROKEN as error:
        raise ConfigError(f"{path}: cannot be read as a CAN log: {unforeseen(error)}") from error
    if path.suffix == ".blf" and written != path.stat().st_size:
        raise ConfigError(
            f"{path}: cut off or not closed: {path.stat().st_size} bytes, its header says {written}"
        )
    names = [name for name in rows if name is not None]
    chosen = channel if channel is not None else (names[0] if len(names) == 1 else None)
    if not rows:
        raise ConfigError(f"{path}: holds no CAN frame")
    if chosen not in rows:
        raise ConfigError(
            f"{path}: has the channels {', '.join(names)}; choose one as {path.name}:CHANNEL"
        )
    return rows_of(b"".join(rows[chosen])).copy()


def _options(path: Path) -> dict[str, bool]:
    """Return the options that make python-can's reader give absolute times."""
    return {"relative_timestamp": False} if path.suffix == ".asc" else {}


def _refuse_cut(path: Path) -> None:
    """Raise ValueError for an empty file, or a text log whose last line has no line end."""
    with path.open("rb") as file:
        if not file.seek(0, 2):
            raise ValueError("it is empty")
        file.seek(-1, 2)
        if path.suffix in TEXT_LOGS and file.read(1) != b"\n":
            raise ValueError("its last line is cut off")
