"""Read captures of raw traffic: logs of CAN buses, and stamped bytes of serial lines."""

import csv
import io
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from fsw.config import Config
from fsw.drivers.codecs.canopen import COB_SYNC, COB_TPDO1, NODE_MASK
from fsw.drivers.layout.joints import all_layouts
from fsw.drivers.wire import ByteChunk, FrameArray
from fsw.errors import ConfigError, brief
from fsw.exchange.recording import END_NS
from fsw.exchange.recording_writer import RecordingWriter
from fsw.exchange.sinks import IMU, CanTraffic, SerialTraffic
from fsw.messages import IntArray
from offline.can_logs.reading import read_can_log
from offline.importing.clock import (
    refuse_differences,
    refuse_disorder,
    refuse_other_rate,
    refuse_other_size,
)
from offline.importing.decoded import decoded_lines

MOST_S = 1e12  # a stamp beyond is not a time
STAMP, DATA = "stamp_s", "hex"
_Row = tuple[int, Any, Any]  # line, stamp, bytes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Channel:
    """One channel of a recording: its stamps, a description, and a function that writes it."""

    topic: str
    source: Path
    t_ns: IntArray  # (k,), k > 0
    text: str  # describes the data for the user
    write: Callable[[RecordingWriter], None]
    details: Sequence[str] = ()  # lines on what a description reads in it


def can_capture(config: Config, bus: str, path: Path, channel: str | None, shift: int) -> Channel:
    """Return the capture of a bus from a CAN log; `shift` [ns] is added to the stamps.

    Raises
    ------
    ConfigError when the log cannot be used, or is of another robot.
    """
    log = read_can_log(path, channel)
    frames = log.frames
    first, last = (int(end) + shift for end in (frames["t_ns"].min(), frames["t_ns"].max()))
    if first < 0 or last >= END_NS - 1:
        words = f"{first * 1e-9:g} to {last * 1e-9:g} s; must be 0 to less than {END_NS * 1e-9:g}"
        raise ConfigError(f"{path}: stamps with --shift from {words}")
    frames["t_ns"] += shift
    t_ns = frames["t_ns"].astype(np.int64)
    _refuse_strangers(config, bus, frames, path)
    place = next(k for k, own in enumerate(config.buses) if own.name == bus)
    syncs_ns = t_ns[frames["word"] == COB_SYNC]
    rates_hz = {f"buses.{place}.rate_hz": config.buses[place].rate_hz}
    if config.buses[place].sync != "none":
        refuse_differences(path, "SYNC", syncs_ns, rates_hz, what=f"{len(frames)} frames")
        refuse_other_rate(path, "SYNC", syncs_ns, rates_hz)
    refuse_disorder(path, t_ns)
    words = f"{len(frames)} frames in {(t_ns[-1] - t_ns[0]) * 1e-9:.1f} s"
    return Channel(
        topic=f"/can/{bus}",
        source=path,
        t_ns=t_ns,
        text="; ".join([words, *log.notes]),
        write=lambda writer: writer.traffic(CanTraffic(bus, frames)),
        details=decoded_lines(config, config.buses[place], frames),
    )


def serial_capture(config: Config, device: str, path: Path, shift: int) -> Channel:
    """Return the capture of a serial line: rows of `stamp_s` and `hex`, as CSV or JSON lines.

    A row contains the bytes of one read; its stamp is the time of the last byte [s]. `shift` [ns]
    is added to the stamps.

    Raises
    ------
    ConfigError when the file cannot be used.
    """
    text = read_text(path)
    rows = _of_json(path, text) if text.lstrip().startswith("{") else _of_csv(path, text)
    chunks = []
    for line, stamp, data in rows:
        try:
            seconds = Decimal(stamp)
            if not abs(seconds) < MOST_S:  # a larger exponent would fill the memory
                raise OverflowError("no time")
            t_ns = int((seconds * 10**9).to_integral_value()) + shift
            chunks.append(ByteChunk(t_ns, bytes.fromhex(data)))
        except (ValueError, TypeError, ArithmeticError) as error:
            words = f"{STAMP} {brief(str(stamp))}, {DATA} {brief(data)}"
            raise ConfigError(
                f"{path}: line {line}: {words}; must be seconds and hexadecimal bytes"
            ) from error
    if not chunks:
        raise ConfigError(f"{path}: holds no bytes")
    times_ns = np.array([min(max(c.t_ns, -1), END_NS - 1) for c in chunks], np.int64)
    sizes = np.array([len(chunk.data) for chunk in chunks], np.int64)
    unit = config.imu if device == IMU else config.star_tracker
    if unit is not None:
        refuse_other_size(path, times_ns, sizes, f"{device}.rate_hz", unit.rate_hz)
    refuse_disorder(path, times_ns)
    return Channel(
        topic=f"/serial/{device}",
        source=path,
        t_ns=times_ns,
        text=f"{sizes.sum()} bytes in {(times_ns[-1] - times_ns[0]) * 1e-9:.1f} s",
        write=lambda writer: writer.traffic(SerialTraffic(device, chunks)),
    )


def read_text(path: Path) -> str:
    """Return the text of a file.

    Raises
    ------
    ConfigError when the file cannot be read, is empty, or does not end with a newline.
    """
    try:
        text = path.read_text("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        words = error.strerror if isinstance(error, OSError) else "it is not text"
        raise ConfigError(f"{path}: cannot be read: {words}") from error
    if not text.strip():
        raise ConfigError(f"{path}: is empty")
    if not text.endswith("\n"):
        raise ConfigError(f"{path}: its last line is cut off; end it with a newline, or remove it")
    return text


def _refuse_strangers(config: Config, bus: str, frames: FrameArray, path: Path) -> None:
    """Raise ConfigError if the log has no SYNC, or a configured node sends no TPDO1."""
    words = {int(word) for word in np.unique(frames["word"])}
    own = next(each for each in config.buses if each.name == bus)
    for at, layout in all_layouts(config, own).items():
        for message in layout.messages:
            if message.word not in words:
                name = config.bus_devices[at].name
                raise ConfigError(
                    f"{path}: no frame {message.name} (0x{message.identifier:x}) of {name}: the "
                    "recording of another robot or bus"
                )
    if own.sync != "none" and COB_SYNC not in words:
        raise ConfigError(f"{path}: no SYNC frame (0x{COB_SYNC:03x}); samples have no time")
    found = {word & NODE_MASK for word in words if COB_TPDO1 < word <= COB_TPDO1 | NODE_MASK}
    nodes = [node for node in config.can_nodes if node.bus == bus and node.driver == "canopen"]
    silent = [node for node in nodes if node.node_id not in found]
    if silent:
        names = ", ".join(f"{node.name} (node 0x{node.node_id:02x})" for node in silent)
        others = ", ".join(f"0x{node:02x}" for node in sorted(found)) or "no node"
        raise ConfigError(
            f"{path}: nothing of {names}; {others} send: the recording of another robot or bus"
        )


def _of_csv(path: Path, text: str) -> Iterator[_Row]:
    reader = csv.DictReader(io.StringIO(text))
    try:
        missing = {STAMP, DATA} - set(reader.fieldnames or ())
    except csv.Error as error:
        raise ConfigError(f"{path}: line 1: {error}") from error
    if missing:
        raise ConfigError(f"{path}: no column {', '.join(sorted(missing))} in its first line")
    try:
        for row in reader:
            yield reader.line_num, row[STAMP], row[DATA]
    except csv.Error as error:
        raise ConfigError(f"{path}: line {reader.line_num + 1}: {error}") from error


def _of_json(path: Path, text: str) -> Iterator[_Row]:
    for number, line in enumerate(text.splitlines(), 1):
        try:
            row = json.loads(line, parse_float=Decimal)
            yield number, row[STAMP], row[DATA]
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise ConfigError(f"{path}: line {number}: not JSON with {STAMP} and {DATA}") from error
