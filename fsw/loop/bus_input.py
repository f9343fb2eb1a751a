"""A CAN bus as an input of the loop: it sends SYNC, reads frames and hands them over in batches.

Every tick drains the ports. A batch has the frames of a bus in the order of the wire, including the
frames that this computer sent (such as SYNC), and stamps never decrease. The recording and the
estimation get the same order.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fsw.clock import Clock
from fsw.drivers.codecs.canopen import encode_sync
from fsw.drivers.codecs.sdo import COB_REPLY
from fsw.drivers.wire import (
    NO_FRAMES,
    SFF_MASK,
    CanFrame,
    FrameArray,
    FramePort,
    frame_array,
    frame_at,
    joined,
    row_of,
)
from fsw.exchange.sinks import CanTraffic, Sink
from fsw.loop.link import Link
from fsw.loop.node_setup import NodeSetup
from fsw.messages import Event

COB_HEARTBEAT = 0x700
NODE_MASK = 0x07F
_NO_NODE = np.uint32(0xFFFFFFFF & ~NODE_MASK)
BOOT_UP = b"\x00"
NOT_STARTED = (BOOT_UP, b"\x7f")  # heartbeats of a node that waits for its start
QUIET_NS = 1_000_000_000  # shortest time between two reports of lost frames
BACK_TOLERANCE_NS = 1_000_000  # error between stamps of two clocks; less than a SYNC period
HELD_NS = 1_000_000  # a send takes some 40 us; if it takes this long, the kernel did other work
NO_SETUPS: Mapping[int, NodeSetup] = MappingProxyType({})
LATE_NS = 2_000_000_000  # longest wait for the echo of a sent frame


class Selector(Protocol):
    """Chooses the active one of two redundant buses."""

    active: int
    switches: int

    @property
    def name(self) -> str:
        """Name of the active bus."""
        ...

    def hear(self) -> None:
        """Note that a frame of a configured node was just read from the active bus."""
        ...

    def poll(self, now_ns: int, up: tuple[bool, bool]) -> str:
        """Switch buses if due; return the reason, or "". `up`: whether each bus has its port."""
        ...


class BusInput:
    """Sends SYNC and NMT on one CAN bus or the active bus of a redundant pair; reads its frames."""

    def __init__(
        self,
        name: str,
        nodes: Mapping[int, tuple[int, bytes]],
        links: Sequence[Link[FramePort]],
        sync_counter_max: int,
        clock: Clock,
        heartbeat: tuple[int, bytes],
        selector: Selector | None = None,
        *,
        listen_only: bool = False,
        setups: Mapping[int, NodeSetup] = NO_SETUPS,
    ) -> None:
        """Store the links; open nothing.

        Parameters
        ----------
        nodes : identifier and data of the NMT start frame of each configured node, by node number
        sync_counter_max : largest counter of SYNC; 0: SYNC has no data
        listen_only : never send a frame
        setups : what is done with nodes before they are started, by node number
        links : one bus; or the nominal and the redundant bus, between which `selector` chooses
        """
        self.name = name
        self.links = tuple(links)
        self.selector = selector
        self._sync_counter, self._sync_counter_max = 0, sync_counter_max  # of the last SYNC sent
        self._heartbeat = heartbeat
        self._listen_only = listen_only
        self._setups = {} if listen_only else setups
        self._talking_since_ns: int | None = None  # first frame sent on the active bus
        self._nodes = nodes
        self._clock = clock
        self._sent: list[tuple[int, CanFrame]] = []
        self._awaited: list[tuple[int, CanFrame]] = []  # handed over, without an echo so far
        self._hands_back = False  # of the port that sent the newest frame; it may be lost by now
        self._newest_ns = -(1 << 62)
        self.overflowed = 0  # received frames the port had no room for
        self._held_ns = 0  # time in sends of HELD_NS or longer, since the last query
        self.unsent = 0  # frames the port's transmit queue had no room for
        self._trouble = (0, 0)  # (overflowed, unsent) at the last report
        self._reported_ns = self._newest_ns
        self._places = np.zeros(SFF_MASK + 1, np.bool_)  # by identifier: of a configured node?
        for node in nodes:
            self._places[node :: NODE_MASK + 1] = True
        self._drained: list[Callable[[], FrameArray]] = []
        self._unread: list[Callable[[], FrameArray]] = []  # the batch, not read yet
        self._taken = NO_FRAMES  # the batch as read, before the merge with the frames sent
        self._taken_sent: list[tuple[int, CanFrame]] = []
        self._ordered = NO_FRAMES

    @property
    def link(self) -> Link[FramePort]:
        """Link of the active bus."""
        return self.links[0 if self.selector is None else self.selector.active]

    def summary(self) -> dict[str, int | str]:
        """Return the counts of lost frames and the state of the redundant pair as plain values."""
        values: dict[str, int | str] = {"overflow": self.overflowed, "unsent": self.unsent}
        if self.selector is not None:
            values |= {"active": self.selector.name, "switches": self.selector.switches}
        return values

    def start_nodes(self) -> None:
        """Send NMT start to every configured node, or begin its setup. Raises PortError."""
        for node in self._nodes:
            self._start(node)

    def _start(self, node: int) -> None:
        setup = self._setups.get(node)
        frames = [self._nodes[node]] if setup is None else setup.start(self._clock.now_ns())
        for can_id, data in frames:
            self._send(can_id, data)

    def _set_up(self, read: FrameArray, sink: Sink) -> None:
        """Continue the dialogues with nodes. Raises PortError."""
        now_ns = self._clock.now_ns()
        found = [setup.poll(now_ns) for setup in self._setups.values()]
        words = read["word"]
        for row in ((words > COB_REPLY) & (words <= COB_REPLY + NODE_MASK)).nonzero()[0].tolist():
            frame = frame_at(read, row)
            setup = self._setups.get(frame.can_id - COB_REPLY)
            found += [] if setup is None else [setup.hear(frame, now_ns)]
        for frames, event in found:
            if event is not None:
                severity, code, text = event
                sink.put(Event(now_ns, severity, code, f"{self.name}: {text}"))
            for can_id, data in frames:
                self._send(can_id, data)

    def send_sync(self) -> None:
        """Send the next SYNC. Raises PortError."""
        most = self._sync_counter_max
        counter = self._sync_counter % most + 1 if most else 0
        if self.link.up and self._send(*encode_sync(counter)):
            self._sync_counter = counter

    def send_heartbeat(self) -> None:
        """Send the computer's heartbeat. Raises PortError."""
        self._send(*self._heartbeat)

    def take_held_ns(self) -> int:
        """Return the total time [ns] of sends of HELD_NS or longer since the last call."""
        held_ns, self._held_ns = self._held_ns, 0
        return held_ns

    @property
    def idle_links(self) -> tuple[Link[FramePort], ...]:
        """Links that are not active: one of a redundant pair, none of a single bus."""
        return tuple(link for link in self.links if link is not self.link)

    @staticmethod
    def drain_idle(link: Link[FramePort]) -> None:
        """Drain and discard the frames of an idle bus. Raises PortError."""
        if link.port is not None:
            link.port.drain()
            link.port.take()

    def select(self, sink: Sink) -> bool:
        """Switch to the other bus if the active one is lost; return whether it was switched."""
        if self.selector is None:
            return False
        now_ns = self._clock.now_ns()
        before = self.link
        reason = self.selector.poll(now_ns, (self.links[0].up, self.links[1].up))
        if reason:
            self._keep(before)
            self._talking_since_ns = None
            text = f"{before.name}: {reason}; {self.link.name} is active"
            sink.put(Event(now_ns, "high", "BUS_SWITCHED", text))
        return bool(reason)

    def drain(self) -> None:
        """Drain the waiting frames of the active bus. Raises PortError."""
        if self.link.port is not None:
            self.link.port.drain()

    def keep(self) -> None:
        """Keep the frames that the active port has drained: it closes, or a batch ends."""
        self._keep(self.link)

    def _keep(self, link: Link[FramePort]) -> None:
        if link.port is not None:
            self._drained.append(link.port.take())

    def take(self) -> None:
        """End a batch: the frames drained and sent so far belong to it."""
        self.keep()
        self._unread, self._drained = self._drained, []
        self._taken_sent, self._sent = self._sent, []

    def read(self) -> None:
        """Read the frames of the batch."""
        unread, self._unread = self._unread, []
        self._taken = joined([read() for read in unread])

    def order(self) -> None:
        """Merge the read and the sent frames of the batch in the order of the wire."""
        self._ordered = self._in_order(self._taken)
        self._taken_sent = []

    def hand_over(self, sink: Sink) -> None:
        """Put the batch into the sink; start the nodes whose heartbeat shows that they wait.

        Raises PortError when a node cannot be started.
        """
        if self.link.port is not None:
            self.overflowed += self.link.port.take_dropped()
            self._report_trouble(sink)
        frames, read = self._ordered, self._taken
        self._ordered = self._taken = NO_FRAMES
        if self._setups:
            self._set_up(read, sink)
        if not len(frames):
            return
        sink.put(CanTraffic(self.name, frames))
        words = read["word"]
        if self.selector is not None and self._talking_since_ns is not None:
            # older frames waited in the port: their nodes may have left this bus since
            heard = words[read["t_ns"] >= self._talking_since_ns]
            if self._places[heard[heard <= SFF_MASK]].any():
                self.selector.hear()
        for row in (words & _NO_NODE == COB_HEARTBEAT).nonzero()[0].tolist():
            frame = frame_at(read, row)
            node = frame.can_id & NODE_MASK
            own = self._setups.get(node)
            waits = own is not None and (own.is_running or own.is_refused)
            is_due = frame.data == BOOT_UP or (frame.data in NOT_STARTED and not waits)
            if is_due and node in self._nodes:
                self._start(node)

    def _send(self, can_id: int, data: bytes) -> bool:
        """Send one frame; return False if it was not sent. Raises PortError."""
        port = self.link.port
        if port is None or self._listen_only:
            return False
        before_ns = self._clock.now_ns()
        sent = port.write(can_id, data)
        if sent is None:
            self.unsent += 1
            return False
        self._hands_back = port.hands_back
        self._sent.append((before_ns, sent))
        if sent.t_ns - before_ns >= HELD_NS:
            self._held_ns += sent.t_ns - before_ns
        if self._talking_since_ns is None:
            self._talking_since_ns = before_ns
        return True

    def _report_trouble(self, sink: Sink) -> None:
        """Report frames lost in the port since the last report as events, at most once a second."""
        trouble = (self.overflowed, self.unsent)
        now_ns = self._clock.now_ns()
        if trouble == self._trouble or now_ns - self._reported_ns < QUIET_NS:
            return
        kinds = (
            ("CAN_OVERFLOW", "received frames found no room"),
            ("CAN_UNSENT", "frames could not be sent, the queue is full"),
        )
        for (code, text), before, count in zip(kinds, self._trouble, trouble, strict=True):
            if count > before:
                report = f"{self.name}: {count - before} {text} ({count} in all)"
                sink.put(Event(now_ns, "medium", code, report))
        self._trouble, self._reported_ns = trouble, now_ns

    def _in_order(self, read: FrameArray) -> FrameArray:
        """Return the frames sent and read in one order, with stamps that never decrease."""
        frames = self._with_sent(read) if self._taken_sent or self._awaited else read
        if len(frames):
            t_ns = np.maximum.accumulate(np.maximum(frames["t_ns"], self._newest_ns))
            frames["t_ns"] = t_ns
            self._newest_ns = int(t_ns[-1])
        return frames

    def _with_sent(self, read: FrameArray) -> FrameArray:
        """Return the frames read, with every frame sent at the place that its echo's stamp gives.

        The kernel stamps the echo. The stamp of `write` is taken after sending and is late. An echo
        may be read after the answers to its frame; its stamp still gives the right place. A frame
        without an echo is placed before all frames stamped after its sending began; if its echo is
        read later, the echo is left out.
        """
        back_at = self._all_back(read)
        if back_at is not None:
            t_ns = read["t_ns"]
            back_ns, before_ns = t_ns[back_at], [before_ns for before_ns, _ in self._taken_sent]
            is_in_order = (t_ns[1:] >= t_ns[:-1]).all() and (back_ns >= before_ns).all()
            if is_in_order and (t_ns.searchsorted(back_ns) == back_at).all():
                return read
            back_frames = read[back_at]
            back_frames["t_ns"] = np.maximum(back_ns, before_ns)
            return _inserted(np.delete(read, back_at), back_frames, back_frames["t_ns"])
        now_ns = self._clock.now_ns()
        identifiers = {item.can_id for _, item in (*self._taken_sent, *self._awaited)}
        rows: list[int] = []
        if self._hands_back:
            rows = np.flatnonzero(np.isin(read["word"], list(identifiers))).tolist()
        back = {row: frame_at(read, row) for row in rows}
        sent = [(item, _take_back(back, item)) for item in self._taken_sent]
        self._awaited = [
            item
            for item in self._awaited
            if _take_back(back, item) is None and now_ns - item[0] < LATE_NS
        ]
        own, after_ns = [], []
        for item, frame in sent:
            first_after_ns, stamped = item
            if frame is not None:
                first_after_ns = max(first_after_ns, frame.t_ns)
                stamped = replace(stamped, t_ns=first_after_ns)
            elif self._hands_back:
                self._awaited.append(item)
            own.append(stamped)
            after_ns.append(first_after_ns)
        foreign = np.ones(len(read), np.bool_)
        foreign[[row for row in rows if row not in back]] = False
        return _inserted(read[foreign], frame_array(own), after_ns)

    def _all_back(self, read: FrameArray) -> NDArray[np.intp] | None:
        """Return the rows of `read` that echo all sent frames in order; None if that fails."""
        if self._awaited or not self._hands_back:
            return None
        before_ns, sent = zip(*self._taken_sent, strict=True)
        words = read["word"]
        is_ours = [words == can_id for can_id in {item.can_id for item in sent}]
        rows = np.logical_or.reduce(is_ours).nonzero()[0]
        if len(rows) != len(sent):
            return None
        back = read[rows]
        if (back["t_ns"] < np.array(before_ns) - BACK_TOLERANCE_NS).any():
            return None
        back["t_ns"] = 0
        wanted = b"".join(_sent_row(item.can_id, item.data) for item in sent)
        return rows if back.tobytes() == wanted else None


@lru_cache(maxsize=1024)
def _sent_row(can_id: int, data: bytes) -> bytes:
    """Return a classic frame as the bytes of a `FRAME` row with stamp 0."""
    return row_of(0, can_id, data)


def _inserted(
    others: FrameArray, own: FrameArray, after_ns: Sequence[int] | NDArray[np.int64]
) -> FrameArray:
    """Return all frames: each own frame stands before the others stamped at its time or later."""
    places = np.searchsorted(np.maximum.accumulate(others["t_ns"]), np.maximum.accumulate(after_ns))
    merged: FrameArray = np.insert(others, places, own)
    return merged


def _take_back(read: dict[int, CanFrame], item: tuple[int, CanFrame]) -> CanFrame | None:
    """Remove and return the echo of `item` (send time [ns], frame) in `read`; None: no echo."""
    before_ns, sent = item
    for row, frame in read.items():
        if (frame.can_id, frame.data) == (sent.can_id, sent.data) and not (
            frame.t_ns < before_ns - BACK_TOLERANCE_NS
        ):
            return read.pop(row)
    return None
