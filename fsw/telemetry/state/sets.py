"""Where the values of every housekeeping set come from."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from fsw.telemetry.dictionary import dictionary_crc32
from fsw.telemetry.link.server import LinkCounters
from fsw.telemetry.link.uplink import security_counters
from fsw.telemetry.services.housekeeping import NAMES

if TYPE_CHECKING:
    from fsw.telemetry.application import TelemetryApplication

FILE_COUNTERS = ("files_sent", "files_received", "files_failed", "pdus_sent", "pdus_received")


class Sets:
    """Reads the application's parts."""

    def __init__(self, application: TelemetryApplication) -> None:
        self._app = application
        self._dictionary_crc32 = dictionary_crc32()

    def builders(self) -> dict[int, Callable[[], Mapping[str, Any]]]:
        """Return what makes the values of each set."""
        knowledge = self._app.knowledge
        return {
            1: self._health,
            2: knowledge.estimates,
            3: knowledge.covariance,
            4: knowledge.devices,
            5: knowledge.job,
            6: self._tables,
            7: self._recorder,
            8: self._link,
        }

    def watched(self, packet: str) -> tuple[Mapping[str, Any], float]:
        """Return values of a set by its name, and how old they are [s]."""
        sid = next(number for number, name in NAMES.items() if name == packet)
        knowledge = self._app.knowledge
        age_s = knowledge.summary_age_s
        if packet in ("estimate", "covariance"):
            age_s = knowledge.estimate_age_s()
        return self.builders()[sid](), age_s

    def _health(self) -> dict[str, Any]:
        app = self._app
        counters = asdict(app.dispatcher.counters)
        del counters["tc_packets"], counters["tc_not_authorised"]
        return {
            "mode": int(app.modes.mode),
            "health": app.supervision.health.latched,
            "health_now": app.supervision.health.now,
            "boot_count": app.boot.count,
            "reset_cause": app.boot.cause,
            "met_s": app.host.now_ns() * 1e-9,
            "config_crc32": app.config_crc32,
            "dictionary_crc32": self._dictionary_crc32,
            **app.knowledge.loop(),
            **counters,
            "events": app.events.total,
            "events_suppressed": app.events.suppressed,
            "command_loss_left_s": app.supervision.command_loss_left_s,
        }

    def _tables(self) -> dict[str, Any]:
        return self._app.tables.values()

    def _recorder(self) -> dict[str, Any]:
        recording = self._app.host.recording
        path = recording.path
        size = free = 0
        try:
            folder = self._app.state if path is None else path.parent
            free = shutil.disk_usage(folder).free
            size = 0 if path is None else path.stat().st_size
        except OSError:
            pass  # the recorder's own events tell of it
        words = {"file": path.name if path is not None else ""}
        return dict(recording.values()) | words | {"file_bytes": size, "disk_free_bytes": free}

    def _link(self) -> dict[str, Any]:
        app = self._app
        counters = asdict(app.link.counters if app.link is not None else LinkCounters())
        files = app.delivery.counters() if app.delivery is not None else {}
        return {
            "met_s": app.host.now_ns() * 1e-9,
            "boot_count": app.boot.count,
            "tc_security": app.security is not None,
            "clients": app.link.clients if app.link is not None else 0,
            "tc_packets": app.dispatcher.counters.tc_packets,
            "tc_not_authorised": app.dispatcher.counters.tc_not_authorised,
            **counters,
            **security_counters(None if app.security is None else app.security.receiver),
            **{name: files.get(name, 0) for name in FILE_COUNTERS},
            "schedule_enabled": app.onboard.schedule.enabled,
            "schedule_entries": app.onboard.schedule.entries,
            "schedule_released": app.onboard.schedule.released,
            "schedule_discarded": app.onboard.schedule.discarded,
        }
