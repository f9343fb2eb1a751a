"""Frames of CAN logs from other tools, in any format that python-can reads, and BUSMASTER."""

import logging
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import can

from fsw.drivers.ports.can_bus import message_row
from fsw.drivers.wire import MAX_DATA_BYTES, FrameArray, rows_of
from fsw.errors import ConfigError, brief, unforeseen
from offline.can_logs.text import BINARY, TextLog, text_log

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
    ArithmeticError,
    AttributeError,
    AssertionError,
    EOFError,
    ImportError,
    MemoryError,
    NotImplementedError,
    struct.error,
    zlib.error,
)
_READERS = {
    ".asc": can.ASCReader,
    ".csv": can.CSVReader,
    ".log": can.CanutilsLogReader,
    ".trc": can.TRCReader,
}
_OBJECT = struct.Struct("<8xII")  # of BLF: signature and header, size of the object, type
_Rows = dict[str | None, list[bytes]]  # frames by channel


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CanLog:
    """Frames of one channel of a log, and what a user must know about their times and losses."""

    frames: FrameArray  # in the log's order, with the log's stamps
    notes: Sequence[str]


def read_can_log(path: Path, channel: str | None = None) -> CanLog:
    """Return the frames of a log in the log's order and with the log's stamps.

    Parameters
    ----------
    channel : one of the log's channels, as python-can names it; None: the log has only one

    Raises
    ------
    ConfigError when the log cannot be read, is cut off, has no frame or lacks this channel, when
    its stamps are not times, or when most of its lines are not frames.
    """
    try:
        if path.suffix.lower() in BINARY:
            rows, notes = _binary(path)
        else:
            rows, notes = _text(path)
    except ConfigError:
        raise
    except _BROKEN as error:
        words = (isinstance(error, OSError) and error.strerror) or unforeseen(error)
        raise ConfigError(f"{path}: cannot be read as a CAN log: {words}") from error
    names = [name for name in rows if name is not None]
    chosen = channel if channel is not None else (names[0] if len(names) == 1 else None)
    if not rows:
        raise ConfigError(f"{path}: holds no CAN frame")
    if chosen not in rows:
        raise ConfigError(
            f"{path}: has the channels {', '.join(names)}; choose one as {path.name}:CHANNEL"
        )
    return CanLog(frames=rows_of(b"".join(rows[chosen])).copy(), notes=notes)


def _binary(path: Path) -> tuple[_Rows, list[str]]:
    if not path.stat().st_size:
        raise ValueError("it is empty")
    rows: _Rows = {}
    notes = []
    with _Warnings() as warnings:
        if path.suffix.lower() == ".blf":
            with path.open("rb") as file:
                reader = _BlfReader(file)
                found = [_row(message) for message in reader]
                written = reader.file_size
                if reader.start_timestamp:
                    start = datetime.fromtimestamp(reader.start_timestamp, UTC)
                    shown = start.replace(tzinfo=None).isoformat(" ", "milliseconds")
                    notes.append(f"starts {shown} by its header, read as UTC")
        else:
            with can.LogReader(path) as other:
                found = [_row(message) for message in other]
            written = path.stat().st_size
    for channel, row in found:
        rows.setdefault(channel, []).append(row)
    if written != path.stat().st_size:
        raise ConfigError(
            f"{path}: cut off or not closed: {path.stat().st_size} bytes, its header says {written}"
        )
    return rows, notes + [f"python-can warns: {text}" for text in warnings.texts]


def _text(path: Path) -> tuple[_Rows, list[str]]:
    log = text_log(path)
    rows: _Rows = {}
    with _Warnings():  # a warning concerns a line that is counted
        for channel, row in _rows_of_text(log):
            rows.setdefault(channel, []).append(row)
    read, unread = sum(map(len, rows.values())), log.unread
    first = f"the first is line {unread.number}: {brief(unread.text.strip())}"
    if unread.count > read:
        raise ConfigError(
            f"{path}: cannot be read as a CAN log: {unread.count} of {unread.count + read} lines "
            f"are not frames, {first}"
        )
    return rows, log.notes + [f"lines not read: {unread.count}, {first}"] * bool(unread.count)


def _rows_of_text(log: TextLog) -> Iterator[tuple[str | None, bytes]]:
    """Yield channel and frame of each line of a text log; lines without a frame are counted."""
    while not log.is_done:
        log.repeat_header()
        before = log.line
        try:
            for message in _READERS[log.kind](log):
                row = _row(message, log.t_ns)
                log.accept()
                yield row
        except ConfigError:
            raise
        except _BROKEN:
            if log.line == before:
                raise  # at the header, which every reader reads first


def _row(message: can.Message, t_ns: int | None = None) -> tuple[str | None, bytes]:
    """Return channel and frame of a message, with its own stamp if there is no other."""
    if t_ns is None:
        if not 0.0 <= message.timestamp < END_S:
            raise ValueError(f"a frame at {message.timestamp:g} s")
        t_ns = round(message.timestamp * 1e6) * MICROSECOND_NS
    if len(message.data) > MAX_DATA_BYTES:
        raise ValueError(f"a frame of {len(message.data)} bytes")
    channel = None if message.channel is None else str(message.channel)
    return channel, message_row(t_ns, message)


class _BlfReader(can.BLFReader):
    """python-can's reader, which never ends on a damaged object that says it has no bytes."""

    def _parse_data(self, data: bytes) -> Iterator[can.Message]:
        pos = 0
        while (pos := data.find(b"LOBJ", pos, pos + 8)) >= 0 and pos + _OBJECT.size <= len(data):
            size, _ = _OBJECT.unpack_from(data, pos)
            if size < _OBJECT.size:
                raise can.io.blf.BLFParseError(f"an object of {size} bytes")
            pos += size
        yield from super()._parse_data(data)


class _Warnings(logging.Handler):
    """Keeps the distinct warnings of python-can while it reads, and off the screen."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.texts: list[str] = []
        self._logger = logging.getLogger("can")

    def emit(self, record: logging.LogRecord) -> None:
        """Keep the text of a warning."""
        if record.getMessage() not in self.texts:
            self.texts.append(record.getMessage())

    def __enter__(self) -> "_Warnings":
        self._propagated = self._logger.propagate
        self._logger.propagate = False
        self._logger.addHandler(self)
        return self

    def __exit__(self, *_: object) -> None:
        self._logger.removeHandler(self)
        self._logger.propagate = self._propagated
