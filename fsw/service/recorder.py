"""The recorder: a sink that writes MCAP files with configuration and robot model attached."""

import errno
import uuid
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import yaml
from zstandard import ZstdError

from file_delivery.regular import read_regular
from file_delivery.room import check_room
from fsw.config import Config, load
from fsw.errors import ConfigError
from fsw.exchange.recording import contents
from fsw.exchange.recording_parts import (
    IDENTITY,
    PART,
    identity_of,
    new_first,
    newest_part,
    part_path,
)
from fsw.exchange.recording_writer import RecordingWriter
from fsw.exchange.sinks import (
    AppliedCommand,
    CanTraffic,
    Message,
    SerialTraffic,
    StatusReport,
)
from fsw.exchange.status import estimate_summary
from fsw.messages import Estimate, Event

CONFIGURATION = "configuration.yaml"
ROBOT = "robot.urdf"
CHECKPOINT = "checkpoint.bin"  # the checkpoint that the recorded run continued from
CHUNK_PERIOD_NS = 1_000_000_000  # a chunk is finished at least this often
RETRY_NS = 500_000_000  # time between attempts to open a new part after a failure
LEAST_PART_S = 1.0  # least duration of a part, however fast it grows: limits the number of files
SOON = -1  # writing has failed, and the time of the next attempt is not set yet
NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
RESERVES = 2  # a new part needs this many reserves, so that it does not end at once


def open_recording(
    config: Config, path: Path, part: Mapping[str, str] | None = None
) -> RecordingWriter:
    """Open a recording with configuration and robot model attached. Raises OSError.

    Parameters
    ----------
    part : content of the metadata record `part`
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(".tmp")  # a file with the final name has its attachments
    writer = RecordingWriter(temporary, config.recorder.compression, config.recorder.chunk_bytes)
    values = config.model_dump(mode="json")
    values["robot"]["urdf"] = ROBOT
    text = yaml.safe_dump(values, sort_keys=False).encode()
    try:
        if part is not None:
            writer.metadata(PART, part)
        writer.attach(CONFIGURATION, "application/yaml", text)
        writer.attach(ROBOT, "application/xml", read_regular(config.resolve(config.robot.urdf)))
        writer.sync()
        writer.path = temporary.replace(path)
    except OSError:
        writer.abandon()
        temporary.unlink(missing_ok=True)
        raise
    return writer


class Parts:
    """Opens the files (parts) of one recording, each when the previous one is full or has failed.

    Every part carries the identity of its recording. The number of a recording is never used
    again, even if the recording has been deleted.

    Parameters
    ----------
    resume : continue the newest recording of the directory, whose writer has crashed
    """

    def __init__(self, config: Config, directory: Path, *, resume: bool = False) -> None:
        self._config, self._directory = config, directory
        self._first: Path | None = None
        self._number, self._identity = 0, uuid.uuid4().hex
        newest = newest_part(directory) if resume else None
        identity = _known_identity(part_path(*newest)) if newest is not None else None
        if newest is not None and identity is not None:
            (self._first, self._number), self._identity = newest, identity

    def open(self) -> RecordingWriter:
        """Open the next part. Raises OSError; the next call then tries the same part number."""
        self._directory.mkdir(parents=True, exist_ok=True)
        reserve_bytes = self._config.service.disk_reserve_bytes
        check_room(self._directory, RESERVES * reserve_bytes, new_file=True)
        if self._first is None:
            self._first = new_first(self._directory)
        number = self._number + 1
        part = {"number": str(number), "first": self._first.name, IDENTITY: self._identity}
        writer = open_recording(self._config, part_path(self._first, number), part)
        self._number = number
        return writer

    def has_room(self) -> bool:
        """Return whether the disk has more space than the reserve."""
        try:
            check_room(self._directory, self._config.service.disk_reserve_bytes)
        except OSError as error:
            return error.errno not in NO_SPACE  # any other fault shows when it is written
        return True


def _known_identity(path: Path) -> str | None:
    try:
        return identity_of(path)
    except ConfigError:  # damaged: a new recording begins
        return None


def recorded_config(path: Path, folder: Path) -> Config:
    """Unpack the configuration and robot model of a recording into a folder and read them.

    Raises
    ------
    ConfigError when the recording lacks one of them.
    """
    held = contents(path)
    attachments = held.attachments
    missing = {CONFIGURATION, ROBOT} - set(attachments)
    if missing:
        cut = f"cut off after {path.stat().st_size} bytes, " if held.truncated else ""
        raise ConfigError(f"{path}: {cut}no attachment {sorted(missing)}; give --config")
    for name in (CONFIGURATION, ROBOT):
        (folder / name).write_bytes(attachments[name])
    return load(folder / CONFIGURATION)


class RecorderSink:
    """Writes messages to recording files; a failure ends the file, never the run.

    Parameters
    ----------
    writer : the open recording; None: the first attempt failed and `parts` is tried again
    report : receives severity, code and text when writing fails and when it continues
    parts : opens the next file when one is full or has failed; None: the first file is the only one
    has_room : returns whether the disk has more space than the reserve
    part_bytes, part_s : size [bytes] and duration [s] of a full file; None: no limit
    """

    def __init__(
        self,
        writer: RecordingWriter | None,
        report: Callable[[str, str, str], None],
        *,
        parts: Callable[[], RecordingWriter] | None = None,
        has_room: Callable[[], bool] = lambda: True,
        part_bytes: int | None = None,
        part_s: float | None = None,
    ) -> None:
        self._writer = writer
        self._report = report
        self._parts, self._has_room = parts, has_room
        self._part_bytes, self._part_s = part_bytes, part_s
        self._chunk_ns: int | None = None
        self._began_ns: int | None = None  # start of the file [ns]
        self._retry_ns = 0 if writer is not None else SOON  # 0: all is well
        self._last_path = writer.path if writer is not None else None
        self._unsure = 0  # messages not written to the file for certain
        self.failing = ""  # why the last attempt to write or open a file failed; empty: it did not
        self.lost = 0  # messages that are in no file
        self.dropped = 0  # messages lost in the rings

    @property
    def path(self) -> Path | None:
        """Path of the file being written, or of the last one; None before the first."""
        return self._last_path

    def put(self, message: Message) -> None:
        """Write one message; skip blocks, replies, snapshots and science records."""
        match message:
            case CanTraffic() | SerialTraffic():
                items = message.frames if isinstance(message, CanTraffic) else message.chunks
                self._write(len(items), lambda writer: writer.traffic(message))
            case Estimate():
                self._json("/estimate", message.t_ns, estimate_values(message))
            case Event():
                self._json("/events", message.t_ns, event_values(message))
            case AppliedCommand():
                self._json("/tc", message.t_ns, message.record)
            case StatusReport():
                self._status(message)
            case _:
                return

    def _json(self, topic: str, t_ns: int, values: Mapping[str, Any]) -> None:
        self._write(1, lambda writer: writer.json(topic, t_ns, values))

    def _status(self, status: StatusReport) -> None:
        """Write a status; end the chunk or the file if it is due."""
        t_ns = status.t_ns
        self._follow(t_ns)
        self._json("/tm", t_ns, status.values)
        if self._chunk_ns is None or t_ns - self._chunk_ns >= CHUNK_PERIOD_NS:
            self._chunk_ns = t_ns
            self._write(0, lambda writer: writer.end_chunk())

    def sync(self) -> None:
        """Hand finished chunks to the operating system."""
        self._write(0, lambda writer: writer.sync())
        self._unsure = 0 if self._writer is None else self._writer.open_messages

    def attach(self, name: str, data: bytes) -> None:
        """Attach a file with the given name and content to the recording."""
        self._write(0, lambda writer: writer.attach(name, "application/octet-stream", data))

    def close(self) -> None:
        """Write the drop count, index and footer."""
        self._write(0, self._finish)
        self._writer, self._unsure = None, 0

    def _finish(self, writer: RecordingWriter) -> None:
        counts = {"dropped": str(self.dropped)}
        writer.metadata("recorder", counts | ({"lost": str(self.lost)} if self.lost else {}))
        writer.close()

    def _follow(self, t_ns: int) -> None:
        """Begin the next part when this one is full; after a failure, retry every `RETRY_NS`."""
        writer = self._writer
        if self._parts is None:
            return
        if writer is None:
            if self._retry_ns == SOON:
                self._retry_ns = t_ns + RETRY_NS
            elif t_ns >= self._retry_ns:
                self._next(t_ns, "RECORDER_BACK", self._parts)
            return
        if writer.is_removed:
            self._fail(writer, 0, FileNotFoundError(errno.ENOENT, "removed under way"))
            self._next(t_ns, "RECORDER_BACK", self._parts)
            return
        self._began_ns = t_ns if self._began_ns is None else self._began_ns
        age_s = (t_ns - self._began_ns) * 1e-9
        large = self._part_bytes is not None and writer.size_bytes >= self._part_bytes
        large = large and age_s >= LEAST_PART_S
        long = self._part_s is not None and age_s >= self._part_s
        if large or long:
            self.close()
            self._next(t_ns, None, self._parts)

    def _next(self, t_ns: int, code: str | None, parts: Callable[[], RecordingWriter]) -> None:
        first = self._retry_ns == 0
        self._retry_ns = t_ns + RETRY_NS
        try:
            self._writer = parts()
        except OSError as error:
            if first:
                self.failing = f"no new part: {error.strerror or error}"
                self._report("high", failure_code(error), self.failing)
            return
        self._last_path, self.failing = self._writer.path, ""
        self._began_ns, self._chunk_ns, self._retry_ns = t_ns, t_ns, 0
        if code is not None:
            text = f"{self._last_path}: recording continues; {self.lost} messages were lost"
            self._report("medium", code, text)

    def _write(self, count: int, write: Callable[[RecordingWriter], None]) -> None:
        writer = self._writer
        if writer is None:
            self.lost += count
            return
        try:
            if count and not self._has_room():
                self._finish(writer)
                self._unsure = 0
                raise OSError(errno.ENOSPC, "only the reserve is free")
            write(writer)
            self._unsure += count
        except OSError as error:
            self._fail(writer, count, error)
        except ZstdError as error:  # no data can cause this: memory is short
            raise MemoryError(str(error)) from error

    def _fail(self, writer: RecordingWriter, count: int, error: OSError) -> None:
        """Give a file up and report why; `count` messages and the unfinished ones are lost."""
        self._writer = None
        self.lost, self._unsure = self.lost + self._unsure + count, 0
        self._retry_ns = SOON
        writer.abandon()
        self.failing = f"{writer.path}: {error.strerror or error}"
        self._report("high", failure_code(error), self.failing)


def failure_code(error: OSError) -> str:
    """Return the code of the event for a recording that cannot be written."""
    return "DISK_FULL" if error.errno in NO_SPACE else "RECORDER_FAILED"


def event_values(event: Event) -> dict[str, Any]:
    """Return an event as plain values."""
    return {
        "t_ns": event.t_ns,
        "severity": event.severity,
        "code": event.code,
        "text": event.text,
    }


def estimate_values(estimate: Estimate) -> Mapping[str, Any]:
    """Return an estimate as plain values, mean and covariance included."""
    summary = estimate_summary(estimate) or {}
    return summary | {
        "names": list(estimate.names),
        "mean": estimate.mean.tolist(),
        "covariance": estimate.covariance.tolist(),
    }
