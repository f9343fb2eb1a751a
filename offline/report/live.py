"""Parts of a live report: the status of a running daemon and the recording that it writes."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fsw.config import Config
from fsw.errors import ConfigError, PortError
from fsw.exchange.recording import first_metadata
from fsw.exchange.recording_parts import PART
from fsw.service.control import control
from offline.report.estimate_sections import QUANTITIES
from offline.report.view import Section, Table

LIVE = "live"  # given instead of a recording: the recording of the running daemon
LESS_URGENT = 10  # nice value (0 to 19): after the loop, but before idle tasks


def status_of(config: Config) -> Mapping[str, Any]:
    """Return the status of the daemon that runs with this configuration.

    Raises
    ------
    PortError when no daemon answers, or the daemon has no status yet.
    """
    reply = control(config.resolve(config.service.state_directory), {"command": "status"})
    if not reply["data"]:
        raise PortError(f"{config.name}: the daemon has no status yet; try again in a second")
    data: Mapping[str, Any] = reply["data"]
    return data


def recording_of(status: Mapping[str, Any]) -> Path:
    """Return the first file of the newest recording of the daemon with this status.

    Raises
    ------
    ConfigError when the daemon has written no recording.
    """
    path = status.get("recorder", {}).get("path")
    if path is None:
        raise ConfigError(
            "recorder.directory: the daemon records nothing, so there is nothing to replay; "
            "`fsw ctl CONFIG report` prints what it knows"
        )
    part = Path(path)
    return part.with_name(first_metadata(part, PART).get("first", part.name))


def in_the_background() -> None:
    """Lower the priority of this process, so that the daemon gets the processor first."""
    os.nice(max(0, LESS_URGENT - os.nice(0)))


def now(status: Mapping[str, Any], closed: bool) -> Section:
    """Return the section "Now": newest estimate, open faults and slips of the running daemon.

    Parameters
    ----------
    closed : whether the daemon had closed the recording when it was read
    """
    estimate = status.get("estimate") or {}
    rows = [
        (name, words if part == words else f"{words} {part}", f"{v:.6g}", f"{s:.2g}", unit)
        for name, values in estimate.get("estimate", {}).items()
        for key, words, unit, parts in QUANTITIES
        for part, v, s in zip(
            parts,
            np.atleast_1d(values[key]),
            np.atleast_1d(estimate["sigma"][name][key]),
            strict=True,
        )
    ]
    health = status["health"]
    faults = ", ".join(health.get("faulty") or ()) or "none"
    text = [
        f"{'identifying' if status['identifying'] else 'not identifying'}; "
        f"{estimate.get('blocks', 0)} windows used, {estimate.get('gated', 0)} rejected; "
        f"open faults: {faults}; {status['slips']} slips in {status['ticks']} ticks.",
        "The rest of the page replays "
        + (
            "its last recording to the end; that was closed when it was read."
            if closed
            else "the recording up to its last finished chunk; the daemon continues it."
        ),
    ]
    head = ("body", "quantity", "estimate", "1 sigma", "unit")
    return Section(title="Now", text=text, tables=[Table(head=head, rows=rows)])
