"""Starts and stops recordings, at start-up, at the end and by command."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from fsw.config import Config
from fsw.errors import CommandError
from fsw.service.recorder import Parts, RecorderSink, failure_code

Report = Callable[[str, str, str], None]  # severity, code, text


class RecorderSwitch:
    """Starts and stops the recording; `sink` is None while no recording is in progress."""

    def __init__(self, config: Config, report: Report) -> None:
        self._config, self._report = config, report
        self._last: Path | None = None
        self._lost = self._dropped = 0  # of closed recordings
        self._recordings = 0
        self.sink: RecorderSink | None = None

    @property
    def path(self) -> Path | None:
        """Return the file being written, or the last one; None before the first."""
        return self._last if self.sink is None else self.sink.path

    @property
    def lost(self) -> int:
        """Return the number of messages that could not be written."""
        return self._lost + (0 if self.sink is None else self.sink.lost)

    @property
    def failing(self) -> str:
        """Why a recording in progress is not written; empty if it is written or none runs."""
        return "" if self.sink is None else self.sink.failing

    def configured(self, config: Config) -> None:
        """Set the effective configuration, which the next recording carries."""
        self._config = config

    def open(self, *, resume: bool) -> None:
        """Begin a recording if a directory is configured; report a failure, to be tried again."""
        directory = self._config.recorder.directory
        if directory is None:
            return
        where, settings = self._config.resolve(directory), self._config.recorder
        parts = Parts(self._config, where, resume=resume)
        writer, failing = None, ""
        try:
            writer = parts.open()
        except OSError as error:
            failing = f"{where}: {error.strerror or error}"
            self._report("high", failure_code(error), failing)
        self._recordings += 1
        self.sink = RecorderSink(
            writer,
            self._report,
            parts=parts.open,
            has_room=parts.has_room,
            part_bytes=settings.part_bytes,
            part_s=settings.part_s,
        )
        self.sink.failing = failing

    def close(self, dropped: int) -> None:
        """Close the recording, if any; `dropped`: number of messages lost in the rings."""
        if self.sink is not None:
            self.sink.dropped = dropped
            self.sink.close()
            self._last, self._lost = self.sink.path, self._lost + self.sink.lost
            self.sink = None

    def values(self) -> Mapping[str, Any]:
        """Return the state of the recorder and its counts of messages as plain values."""
        return {
            "recording": self.sink is not None,
            "failed_messages": self.lost,
            "dropped_messages": self._dropped if self.sink is None else self.sink.dropped,
            "recordings": self._recordings,
        }

    def start(self) -> None:
        """Begin a recording by command.

        Raises
        ------
        CommandError BUSY during a recording, NOT_SUPPORTED without a configured directory.
        """
        if self.sink is not None:
            raise CommandError("BUSY", f"{self.path} is being written")
        if self._config.recorder.directory is None:
            raise CommandError("NOT_SUPPORTED", "recorder.directory is not configured")
        self.open(resume=False)
        self._report("info", "RECORDING_STARTED", str(self.path))

    def stop(self) -> None:
        """Close the recording by command.

        Raises
        ------
        CommandError NOT_STAGED when nothing is being recorded.
        """
        if self.sink is None:
            raise CommandError("NOT_STAGED", "nothing is being recorded")
        self._dropped = self.sink.dropped
        self.close(self._dropped)
        self._report("info", "RECORDING_STOPPED", str(self.path))
