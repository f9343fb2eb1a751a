"""The recorder: a sink that writes an MCAP file, and what every recording carries with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from fsw.config import Config, load
from fsw.drivers.wire import ByteChunk, CanFrame
from fsw.errors import ConfigError
from fsw.messages import Estimate, Event
from fsw.recording import RecordingWriter, contents
from fsw.sinks import NullSink, Record
from fsw.status import estimate_summary

CONFIGURATION = "configuration.yaml"
ROBOT = "robot.urdf"
CHUNK_PERIOD_NS = 1_000_000_000  # a chunk is finished at least this often


def next_path(directory: Path) -> Path:
    """Return the first free numbered file name in a directory."""
    number = 1
    while (path := directory / f"recording_{number:04d}.mcap").exists():
        number += 1
    return path


def open_recording(config: Config, path: Path) -> RecordingWriter:
    """Open a recording with configuration and robot model attached. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = RecordingWriter(path, config.recorder.compression, config.recorder.chunk_bytes)
    values = config.model_dump(mode="json")
    values["robot"]["urdf"] = ROBOT
    text = yaml.safe_dump(values, sort_keys=False).encode()
    writer.attach(CONFIGURATION, "application/yaml", text)
    writer.attach(ROBOT, "application/xml", config.resolve(config.robot.urdf).read_bytes())
    return writer


def recorded_config(path: Path, folder: Path) -> Config:
    """Unpack the configuration and robot model of a recording into a folder and read them.

    Raises
    ------
    ConfigError when the recording carries none.
    """
    attachments = contents(path).attachments
    missing = {CONFIGURATION, ROBOT} - set(attachments)
    if missing:
        raise ConfigError(f"{path}: no attachment {sorted(missing)}; give --config")
    for name in (CONFIGURATION, ROBOT):
        (folder / name).write_bytes(attachments[name])
    return load(folder / CONFIGURATION)


class RecorderSink(NullSink):
    """Writes everything but blocks and replies; a failure ends the recording, never the run.

    Parameters
    ----------
    writer : the open recording
    report : told once when writing fails (disk full): severity, code, text
    """

    def __init__(self, writer: RecordingWriter, report: Callable[[str, str, str], None]) -> None:
        self._writer: RecordingWriter | None = writer
        self._report = report
        self._chunk_ns: int | None = None
        self.lost = 0  # messages that came after the failure
        self.dropped = 0  # messages the rings lost before they came here

    def can(self, bus: str, frames: Sequence[CanFrame]) -> None:
        """Write frames."""
        self._write(len(frames), lambda writer: writer.can(bus, frames))

    def serial(self, device: str, chunks: Sequence[ByteChunk]) -> None:
        """Write chunks."""

        def write(writer: RecordingWriter) -> None:
            for chunk in chunks:
                writer.serial(device, chunk.t_ns, chunk.data)

        self._write(len(chunks), write)

    def estimate(self, estimate: Estimate) -> None:
        """Write an estimate with its covariance."""
        values = estimate_values(estimate)
        self._write(1, lambda writer: writer.json("/estimate", estimate.t_ns, values))

    def event(self, event: Event) -> None:
        """Write an event."""
        values = event_values(event)
        self._write(1, lambda writer: writer.json("/events", event.t_ns, values))

    def status(self, t_ns: int, status: Record) -> None:
        """Write a summary; finish the chunk when it has been open for long."""
        self._write(1, lambda writer: writer.json("/tm", t_ns, status))
        if self._chunk_ns is None or t_ns - self._chunk_ns >= CHUNK_PERIOD_NS:
            self._chunk_ns = t_ns
            self._write(0, lambda writer: writer.end_chunk())

    def command(self, t_ns: int, record: Record) -> None:
        """Write an applied command."""
        self._write(1, lambda writer: writer.json("/tc", t_ns, record))

    def sync(self) -> None:
        """Hand finished chunks to the system."""
        self._write(0, lambda writer: writer.sync())

    def close(self) -> None:
        """Write the drop count, index and footer."""

        def finish(writer: RecordingWriter) -> None:
            writer.metadata("recorder", {"dropped": str(self.dropped)})
            writer.close()

        self._write(0, finish)
        self._writer = None

    def _write(self, count: int, write: Callable[[RecordingWriter], None]) -> None:
        writer = self._writer
        if writer is None:
            self.lost += count
            return
        try:
            write(writer)
        except OSError as error:
            self._writer = None
            self.lost += count
            writer.abandon()
            self._report("high", "RECORDER_FAILED", f"{writer.path}: {error.strerror or error}")


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
