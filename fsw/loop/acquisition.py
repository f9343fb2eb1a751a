"""Inputs of the loop: link + source + the items drained but not fed yet.

Two rules make what a source sees a function of recorded stamps alone. Per bus, frames are ordered
as they were on the wire around a SYNC of ours, and stamps never run backwards. And items are fed up
to a deadline: what is stamped later waits until the window has closed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Protocol, TypeVar

from fsw.clock import Clock
from fsw.drivers.wire import ByteChunk, BytePort, CanFrame, FramePort
from fsw.exchange.sinks import CanTraffic, SerialTraffic, Sink
from fsw.loop.link import Link
from fsw.messages import Event, Sample
from fsw.messages.findings import Finding

COB_SYNC = 0x080
COB_HEARTBEAT = 0x700
NODE_MASK = 0x07F
NOT_STARTED = (b"\x00", b"\x7f")  # heartbeats of a node that waits for its start
QUIET_NS = 1_000_000_000  # between two events of one kind
BACK_TOLERANCE_NS = 1_000_000  # of two clocks read at different moments; less than a period
LATE_NS = 100_000_000  # what was sent and has not come back by then never will

Item = TypeVar("Item", CanFrame, ByteChunk)


class FrameSource(Protocol):
    """Codec and counters of one bus's joint nodes."""

    @property
    def counters(self) -> dict[str, int]:
        """Counters by name."""
        ...

    def feed(self, frames: Sequence[CanFrame]) -> Sequence[Sample]:
        """Decode frames in order."""
        ...

    def watch(self, now_ns: int, *, up: bool) -> None:
        """Note whether the bus has its port."""
        ...

    def next_sync(self) -> tuple[int, bytes]:
        """Return identifier and payload of the next SYNC."""
        ...

    def sync_sent(self) -> None:
        """Note that the next SYNC was sent."""
        ...

    def events(self) -> Sequence[tuple[str, str, str]]:
        """Return and forget what happened: severity, code, text."""
        ...

    def motor_side(self) -> Mapping[str, Mapping[str, float]]:
        """Return the newest slow values of every joint by name."""
        ...

    def findings(self) -> Sequence[Finding]:
        """Return and forget what was found wrong."""
        ...


class ChunkSource(Protocol):
    """Codec and counters of one serial device."""

    @property
    def counters(self) -> dict[str, int]:
        """Counters by name."""
        ...

    def feed(self, chunks: Sequence[ByteChunk]) -> Sequence[Sample]:
        """Decode chunks in order."""
        ...

    def findings(self) -> Sequence[Finding]:
        """Return and forget what was found wrong."""
        ...

    def watch(self, now_ns: int, *, up: bool) -> None:
        """Look whether the device has fallen silent; `up`: whether it has its port."""
        ...


class Selector(Protocol):
    """Chooses the active one of two redundant buses."""

    active: int
    switches: int

    @property
    def name(self) -> str:
        """Name of the active bus."""
        ...

    def hear(self) -> None:
        """Note a frame of a configured node, read from the active bus just now."""
        ...

    def poll(self, now_ns: int, up: tuple[bool, bool]) -> str:
        """Switch when that is due; return why, or nothing."""
        ...


class BusInput:
    """One CAN bus, or a redundant pair of which one is active: SYNC and NMT out, frames in."""

    def __init__(
        self,
        name: str,
        nodes: Mapping[int, tuple[int, bytes]],
        links: Sequence[Link[FramePort]],
        source: FrameSource,
        clock: Clock,
        heartbeat: tuple[int, bytes],
        selector: Selector | None = None,
    ) -> None:
        """Nothing is opened.

        Parameters
        ----------
        nodes : NMT start frame of each configured node; empty: nothing is sent
        links : the bus, or nominal and redundant bus with a `selector` between them
        """
        self.name = name
        self.links = tuple(links)
        self.source = source
        self.selector = selector
        self._heartbeat = heartbeat
        self._talking_since_ns: int | None = None  # on the active bus
        self._nodes = nodes
        self._clock = clock
        self._sent: list[tuple[int, CanFrame]] = []
        self._awaited: list[tuple[int, CanFrame]] = []  # recorded already, may still come back
        self._newest_ns = -(1 << 62)
        self.overflowed = 0  # received frames the port had no room for
        self.unsent = 0  # frames its transmit queue had no room for
        self._trouble = (0, 0)  # of both, as last reported
        self._told_ns = self._newest_ns
        self.pending: list[CanFrame] = []

    @property
    def link(self) -> Link[FramePort]:
        """The active bus."""
        return self.links[0 if self.selector is None else self.selector.active]

    def summary(self) -> dict[str, int | str]:
        """Return the bus's own health as plain values."""
        values: dict[str, int | str] = {"overflow": self.overflowed, "unsent": self.unsent}
        if self.selector is not None:
            values |= {"active": self.selector.name, "switches": self.selector.switches}
        return values

    def start_nodes(self) -> None:
        """Send NMT start to every configured node. Raises PortError."""
        for can_id, data in self._nodes.values():
            self._send(can_id, data)

    def send_sync(self) -> None:
        """Send the next SYNC. Raises PortError."""
        if self.link.up and self._send(*self.source.next_sync()):
            self.source.sync_sent()

    def send_heartbeat(self) -> None:
        """Send the computer's heartbeat. Raises PortError."""
        self._send(*self._heartbeat)

    @property
    def idle_links(self) -> tuple[Link[FramePort], ...]:
        """The bus of the pair that is not active, if any."""
        return tuple(link for link in self.links if link is not self.link)

    @staticmethod
    def drain_idle(link: Link[FramePort]) -> None:
        """Forget what a bus that is not active holds. Raises PortError."""
        if link.port is not None:
            link.port.read()

    def select(self, sink: Sink) -> bool:
        """Change to the other bus when the active one is lost; True when that was done."""
        if self.selector is None:
            return False
        now_ns = self._clock.now_ns()
        before = self.link
        reason = self.selector.poll(now_ns, (self.links[0].up, self.links[1].up))
        if reason:
            self._talking_since_ns, self._awaited = None, []
            text = f"{before.name}: {reason}; {self.link.name} is active"
            sink.put(Event(now_ns, "high", "BUS_SWITCHED", text))
        return bool(reason)

    def drain(self, sink: Sink) -> None:
        """Read the port, put sent frames in their place, record. Raises PortError."""
        port = self.link.port
        read = port.read() if port is not None else []
        if port is not None:
            self.overflowed += port.take_dropped()
            self._tell_trouble(sink)
        frames = self._in_order(read)
        if not frames:
            return
        self.pending += frames
        sink.put(CanTraffic(self.name, frames))
        for frame in read:
            node = frame.can_id & NODE_MASK
            if node not in self._nodes or frame.is_error or frame.is_extended:
                continue
            if self.selector is not None and self._is_answer(frame):
                self.selector.hear()
            if frame.can_id == COB_HEARTBEAT + node and frame.data in NOT_STARTED:
                self._send(*self._nodes[node])

    def first_sync_ns(self) -> int | None:
        """Stamp of the first SYNC among what waits to be fed [ns]."""
        for frame in self.pending:
            if frame.can_id == COB_SYNC and not frame.is_extended and not frame.is_error:
                return frame.t_ns
        return None

    def feed(self, until_ns: int) -> Sequence[Sample]:
        """Decode what is stamped at or before `until_ns`."""
        ready, self.pending = split(self.pending, until_ns)
        return self.source.feed(ready) if ready else ()

    def watch(self, now_ns: int) -> None:
        """Report to the source whether it has its port; a lost port is an event."""
        self.source.watch(now_ns, up=self.link.up)

    def _send(self, can_id: int, data: bytes) -> bool:
        """Send one frame; False when it is not out."""
        port = self.link.port
        if port is None:
            return False
        before_ns = self._clock.now_ns()
        sent = port.write(can_id, data)
        if sent is None:
            self.unsent += 1
            return False
        self._sent.append((before_ns, sent))
        if self._talking_since_ns is None:
            self._talking_since_ns = before_ns
        return True

    def _is_answer(self, frame: CanFrame) -> bool:
        """Return whether a frame came after the computer's first word on this bus.

        Older ones have waited in the port; their nodes may have toggled away since.
        """
        return self._talking_since_ns is not None and frame.t_ns >= self._talking_since_ns

    def _tell_trouble(self, sink: Sink) -> None:
        """Raise an event for frames lost in the port, at most one a second and kind."""
        trouble = (self.overflowed, self.unsent)
        now_ns = self._clock.now_ns()
        if trouble == self._trouble or now_ns - self._told_ns < QUIET_NS:
            return
        kinds = (
            ("CAN_OVERFLOW", "received frames found no room"),
            ("CAN_UNSENT", "frames could not be sent, the queue is full"),
        )
        for (code, text), before, count in zip(kinds, self._trouble, trouble, strict=True):
            if count > before:
                told = f"{self.name}: {count - before} {text} ({count} in all)"
                sink.put(Event(now_ns, "medium", code, told))
        self._trouble, self._told_ns = trouble, now_ns

    def _in_order(self, read: list[CanFrame]) -> list[CanFrame]:
        """Merge sent and read frames; stamps never run backwards."""
        frames = self._with_sent(read) if self._sent or self._awaited else read
        for i, frame in enumerate(frames):
            if frame.t_ns < self._newest_ns:
                frames[i] = replace(frame, t_ns=self._newest_ns)
            else:
                self._newest_ns = frame.t_ns
        return frames

    def _with_sent(self, read: list[CanFrame]) -> list[CanFrame]:
        """Put what was sent where the bus handed it back, with the stamp it has there.

        That stamp is the kernel's: ours, taken after sending, is late by whatever came between. A
        frame may come back after the answers to it, but its stamp tells its place. What has not
        come back stands before all that is stamped after its sending began; when it comes later,
        it is there already.
        """
        now_ns, rest = self._clock.now_ns(), list(read)
        frames: list[CanFrame] = []
        sent = [(item, _take_back(rest, item)) for item in self._sent]
        missing = [
            item
            for item in self._awaited
            if _take_back(rest, item) is None and now_ns - item[0] < LATE_NS
        ]
        others = deque(rest)
        for item, back in sent:
            first_after_ns, own = item
            if back is not None:
                first_after_ns = max(first_after_ns, back.t_ns)
                own = replace(own, t_ns=first_after_ns)
            elif self.link.port is not None and self.link.port.hands_back:
                missing.append(item)
            while others and others[0].t_ns < first_after_ns:
                frames.append(others.popleft())
            frames.append(own)
        self._sent, self._awaited = [], missing
        return frames + list(others)


def _take_back(read: list[CanFrame], item: tuple[int, CanFrame]) -> CanFrame | None:
    """Remove and return a frame as it has come back, if it has; with when its sending began."""
    before_ns, sent = item
    for frame in read:
        if (frame.can_id, frame.data) == (sent.can_id, sent.data) and not (
            frame.is_error or frame.is_extended or frame.t_ns < before_ns - BACK_TOLERANCE_NS
        ):
            read.remove(frame)
            return frame
    return None


class LineInput:
    """One serial device: bytes in, and the bytes that ask it to talk."""

    def __init__(
        self, name: str, link: Link[BytePort], source: ChunkSource, start_bytes: bytes
    ) -> None:
        self.name = name
        self.link = link
        self.links = (link,)
        self.source = source
        self._start_bytes = start_bytes
        self._fresh: list[ByteChunk] = []
        self.pending: list[ByteChunk] = []

    def start(self) -> None:
        """Ask the device for its data. Raises PortError."""
        if self._start_bytes and self.link.port is not None:
            self.link.port.write(self._start_bytes)

    def stamp(self) -> None:
        """Read and stamp what is there; nothing else. Raises PortError."""
        if self.link.port is not None:
            self._fresh += self.link.port.read()

    def drain(self, sink: Sink) -> None:
        """Read the port and record. Raises PortError."""
        try:
            self.stamp()
        finally:
            fresh, self._fresh = self._fresh, []
            if fresh:
                self.pending += fresh
                sink.put(SerialTraffic(self.name, fresh))

    def feed(self, until_ns: int) -> Sequence[Sample]:
        """Decode what is stamped at or before `until_ns`."""
        ready, self.pending = split(self.pending, until_ns)
        return self.source.feed(ready) if ready else ()

    def watch(self, now_ns: int) -> None:
        """Look whether the device has fallen silent; a lost port is an event of its own."""
        self.source.watch(now_ns, up=self.link.up)


def split(items: list[Item], until_ns: int) -> tuple[list[Item], list[Item]]:
    """Return the leading items stamped at or before `until_ns`, and the rest."""
    if not items or items[-1].t_ns <= until_ns:
        return items, []
    count = next(i for i, item in enumerate(items) if item.t_ns > until_ns)
    return items[:count], items[count:]
