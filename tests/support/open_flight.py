"""A telemetry application on a fake host with its link open: a thread polls it, time goes along."""

from __future__ import annotations

import threading

from tests.support.application_cases import SECOND, Flight

STEP_NS = SECOND // 50


class OpenFlight:
    """Serves real clients on a port of its own; `with` ends it."""

    def __init__(self, flight: Flight) -> None:
        self.flight = flight
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> OpenFlight:
        self.flight.app.open()
        self._thread.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._stop.set()
        self._thread.join()
        self.flight.app.close()

    @property
    def port(self) -> int:
        """TCP port of the link."""
        return self.flight.app.link.server.port

    def _run(self) -> None:
        while not self._stop.wait(0.002):
            self.flight.now += STEP_NS
            self.flight.app.poll(self.flight.now)
