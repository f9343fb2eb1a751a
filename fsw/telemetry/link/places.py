"""Admits a limited number of clients to the link, one more that commands, and clients on trial.

A client is unknown until it sends something. So if all places are occupied, a new client is on
trial for a limited time. With an accepted telecommand it gets the place reserved for commanding
clients, or that of the oldest client that never commanded. Otherwise it is disconnected.
"""

import socket
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from fsw.telemetry.link.outbox import Outbox
from fsw.telemetry.link.splitter import Uplinked
from fsw.telemetry.link.uplink import Uplink

KEPT_PLACES = 1  # places beyond max_clients, reserved for clients that command
MAX_TRIALS = 4
TRIAL_NS = 5_000_000_000


@dataclass(slots=True)
class LinkClient:
    """A connected client of the link: its socket, its buffers both ways, and its place."""

    connection: socket.socket
    name: str
    uplink: Uplink
    outbox: Outbox
    opened_ns: int
    may_command: bool  # connected to the port for commanding
    read_ns: int  # last time at which it read telemetry, or had read all of it
    on_trial: bool = False
    has_commanded: bool = False
    inbox: deque[Uplinked] = field(default_factory=deque)
    ended: str = ""  # reason for which nothing more is read from the client; empty: it is read
    dropped: int = 0
    reported_drops: int = 0
    is_slow: bool = False  # packets are being dropped
    skipped: int = 0
    resyncs: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Refusal:
    """A client to disconnect, and the reason to send to it."""

    client: LinkClient
    reason: str


def admit(newcomer: LinkClient, others: Sequence[LinkClient], places: int) -> Refusal | None:
    """Give a new client a place, or set it on trial; return a client to disconnect, if any."""
    rivals = [other for other in others if other.may_command == newcomer.may_command]
    newcomer.on_trial = sum(not rival.on_trial for rival in rivals) >= places
    if not newcomer.on_trial:
        return None
    full = f"{places} are connected"
    if not newcomer.may_command:
        return Refusal(client=newcomer, reason=full)
    trials = [rival for rival in rivals if rival.on_trial]
    if len(trials) < MAX_TRIALS:
        return None
    return Refusal(client=min(trials, key=_age), reason=f"{full}, and others wait for a place")


def promote(client: LinkClient, others: Sequence[LinkClient], places: int) -> Refusal | None:
    """Give a commanding client a lasting place; return a client to disconnect, if any."""
    client.has_commanded = True
    if not client.on_trial:
        return None
    seated = [other for other in others if other.may_command and not other.on_trial]
    if len(seated) >= places + KEPT_PLACES:
        idle = [other for other in seated if not other.has_commanded]
        if not idle:
            return Refusal(
                client=client, reason=f"{len(seated)} clients that command are connected"
            )
        client.on_trial = False
        reason = "its place was given to a client that commands"
        return Refusal(client=min(idle, key=_age), reason=reason)
    client.on_trial = False
    return None


def overdue(client: LinkClient, now_ns: int, idle_ns: int, places: int) -> Refusal | None:
    """Return the refusal of a client whose trial or reading is overdue, otherwise None."""
    if client.on_trial and now_ns - client.opened_ns >= TRIAL_NS:
        text = f"{places} are connected, and it sent no telecommand for {TRIAL_NS * 1e-9:g} s"
        return Refusal(client=client, reason=text)
    if client.outbox and now_ns - client.read_ns >= idle_ns:
        return Refusal(client=client, reason=f"it has read nothing for {idle_ns * 1e-9:g} s")
    return None


def _age(client: LinkClient) -> int:
    return client.opened_ns
