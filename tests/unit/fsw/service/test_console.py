"""Events on standard error: those that somebody must act on, and never a service that waits."""

import os
import sys

from fsw.messages import Event
from fsw.service.console import WAITING, Console


def event(severity: str, text: str) -> Event:
    return Event(0, severity, "PORT_LOST", text)


def test_events_of_severity_high_are_printed_in_order(monkeypatch):
    reading, writing = os.pipe()
    with os.fdopen(writing, "w") as stderr, os.fdopen(reading) as lines:
        monkeypatch.setattr(sys, "stderr", stderr)
        console = Console()
        for severity, text in (("high", "imu lost"), ("medium", "late"), ("high", "arm lost")):
            console.event(event(severity, text))
        assert [next(lines) for _ in range(2)] == [
            "fsw: PORT_LOST: imu lost\n",
            "fsw: PORT_LOST: arm lost\n",
        ]


def test_a_terminal_that_is_stopped_holds_up_nothing(monkeypatch):
    reading, writing = os.pipe()  # of 64 KiB, and nobody reads
    with os.fdopen(writing, "w") as stderr:
        monkeypatch.setattr(sys, "stderr", stderr)
        console = Console()
        for _ in range(100 * WAITING):
            console.event(event("high", "x" * 200))
        os.close(reading)
