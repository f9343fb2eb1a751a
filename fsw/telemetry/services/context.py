"""What the services on board have in common: clock, downlink, events, parameters, dispatcher."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fsw.telemetry.services.executor import Report, Send, TcDispatcher
from fsw.telemetry.state.epoch import Epoch


@dataclass(frozen=True, slots=True, kw_only=True)
class TelemetryContext:
    """The application as a service sees it.

    Parameters
    ----------
    now_ns : mission elapsed time [ns]
    epoch : the origin of that time
    state : directory of what survives a restart
    send : sends a packet of the dictionary: name, values
    report : reports an event: code, text
    parameter : value in use of an on-board parameter
    dispatcher : checks, executes and finishes telecommands
    """

    now_ns: Callable[[], int]
    epoch: Callable[[], Epoch]
    state: Path
    send: Send
    report: Report
    parameter: Callable[[str], float]
    dispatcher: TcDispatcher
