"""Collects the values of every housekeeping set from the parts of the application."""

import shutil
from collections.abc import Callable, Mapping
from typing import Any

from fsw.telemetry.dictionary import dictionary_crc32
from fsw.telemetry.dictionary.housekeeping import SET_NAMES
from fsw.telemetry.services.context import TelemetryContext

DICTIONARY_CRC32 = dictionary_crc32()
Source = Callable[[], Mapping[str, Any]]


class HousekeepingValues:
    """Collects the values of housekeeping sets from their sources."""

    def __init__(self, context: TelemetryContext) -> None:
        self._latest = context.latest
        self._sources: dict[int, tuple[Source, ...]] = {}

    def add(self, sid: int, *sources: Source) -> None:
        """Add functions that each return some of the values of the set `sid`."""
        self._sources[sid] = self._sources.get(sid, ()) + sources

    def of(self, sid: int) -> dict[str, Any]:
        """Return all values of the set `sid` by field name."""
        return {name: value for source in self._sources[sid] for name, value in source().items()}

    def watched(self, packet: str) -> tuple[Mapping[str, Any], float]:
        """Return the values of the set named `packet`, and their age [s]."""
        sid = next(number for number, name in SET_NAMES.items() if name == packet)
        from_estimate = packet in ("estimate", "covariance")
        age_s = self._latest.estimate_age_s() if from_estimate else self._latest.summary_age_s
        return self.of(sid), age_s


def run_values(context: TelemetryContext) -> dict[str, Any]:
    """Return the fields of set 1 that describe this run of the daemon."""
    return {
        "mode": int(context.mode_machine.mode),
        "boot_count": context.boot.count,
        "reset_cause": context.boot.cause,
        "met_s": context.now_ns() * 1e-9,
        "config_crc32": context.config_crc32,
        "dictionary_crc32": DICTIONARY_CRC32,
    }


def recorder_values(context: TelemetryContext) -> dict[str, Any]:
    """Return the fields of set 7; if the disk cannot be read, which is reported, sizes are 0."""
    recording = context.host.recording
    path = recording.path
    size = free = 0
    try:
        folder = context.state if path is None else path.parent
        free = shutil.disk_usage(folder).free
        size = 0 if path is None else path.stat().st_size
    except OSError:
        pass
    name = path.name if path is not None else ""
    sizes = {"file": name, "file_bytes": size, "disk_free_bytes": free}
    return dict(recording.values()) | sizes


def time_values(context: TelemetryContext) -> dict[str, Any]:
    """Return the fields of set 8: mission elapsed time [s] and number of starts."""
    return {"met_s": context.now_ns() * 1e-9, "boot_count": context.boot.count}
