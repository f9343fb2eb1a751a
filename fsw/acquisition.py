"""Inputs of the loop: link + source + the items drained but not fed yet.

Two rules make what a source sees a function of recorded stamps alone. Per bus, frames are ordered
as they were on the wire around a SYNC of ours, and stamps never run backwards. And items are fed up
to a deadline: what is stamped later waits until the window has closed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Protocol, TypeVar

from fsw.clock import Clock
from fsw.drivers.wire import ByteChunk, BytePort, CanFrame, FramePort
from fsw.errors import PortError
from fsw.link import Link
from fsw.messages import Event, Sample
from fsw.sinks import Sink

COB_SYNC = 0x080
COB_HEARTBEAT = 0x700
BOOT_UP = b"\x00"
QUIET_NS = 1_000_000_000  # between two events of one kind

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

    def next_sync(self) -> tuple[int, bytes]:
        """Return identifier and payload of the next SYNC."""
        ...

    def events(self) -> Sequence[tuple[str, str, str]]:
        """Return and forget what happened: severity, code, text."""
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


class BusInput:
    """One CAN bus: SYNC and NMT out, frames in."""

    def __init__(
        self,
        name: str,
        nodes: Mapping[int, tuple[int, bytes]],
        link: Link[FramePort],
        source: FrameSource,
        clock: Clock,
    ) -> None:
        """`nodes` maps each configured node to its NMT start frame; empty: nothing is sent."""
        self.name = name
        self.link = link
        self.source = source
        self._nodes = nodes
        self._clock = clock
        self._sent: list[tuple[int, CanFrame]] = []
        self._newest_ns = -(1 << 62)
        self.overflowed = 0  # received frames the port had no room for
        self.unsent = 0  # frames its transmit queue had no room for
        self._trouble = (0, 0)  # of both, as last told
        self._told_ns = self._newest_ns
        self.pending: list[CanFrame] = []

    def start_nodes(self) -> None:
        """Send NMT start to every configured node. Raises PortError."""
        for can_id, data in self._nodes.values():
            self._send(can_id, data)

    def send_sync(self) -> None:
        """Send the next SYNC. Raises PortError."""
        if self.link.up:
            self._send(*self.source.next_sync())

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
        sink.can(self.name, frames)
        for frame in read:
            node = frame.can_id - COB_HEARTBEAT
            if frame.data == BOOT_UP and node in self._nodes:
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

    def _send(self, can_id: int, data: bytes) -> None:
        port = self.link.port
        if port is not None:
            before_ns = self._clock.now_ns()
            sent = port.write(can_id, data)
            if sent is None:
                self.unsent += 1
            else:
                self._sent.append((before_ns, sent))

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
                sink.event(Event(now_ns, "medium", code, told))
        self._trouble, self._told_ns = trouble, now_ns

    def _in_order(self, read: list[CanFrame]) -> list[CanFrame]:
        """Merge sent and read frames; one stamped after our send began comes after what we sent."""
        if self._sent:
            frames: list[CanFrame] = []
            position = 0
            for before_ns, sent in self._sent:
                while position < len(read) and read[position].t_ns < before_ns:
                    frames.append(read[position])
                    position += 1
                frames.append(sent)
            frames += read[position:]
            self._sent = []
        else:
            frames = read
        for i, frame in enumerate(frames):
            if frame.t_ns < self._newest_ns:
                frames[i] = replace(frame, t_ns=self._newest_ns)
            else:
                self._newest_ns = frame.t_ns
        return frames


class LineInput:
    """One serial device: bytes in, and the bytes that ask it to talk."""

    def __init__(
        self, name: str, link: Link[BytePort], source: ChunkSource, start_bytes: bytes
    ) -> None:
        self.name = name
        self.link = link
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
                sink.serial(self.name, fresh)

    def feed(self, until_ns: int) -> Sequence[Sample]:
        """Decode what is stamped at or before `until_ns`."""
        ready, self.pending = split(self.pending, until_ns)
        return self.source.feed(ready) if ready else ()


def split(items: list[Item], until_ns: int) -> tuple[list[Item], list[Item]]:
    """Return the leading items stamped at or before `until_ns`, and the rest."""
    if not items or items[-1].t_ns <= until_ns:
        return items, []
    count = next(i for i, item in enumerate(items) if item.t_ns > until_ns)
    return items[:count], items[count:]


class LinkKeeper:
    """Loses, retries and restarts links; a link's failure never reaches the loop."""

    def __init__(self, clock: Clock, sink: Sink) -> None:
        self._clock = clock
        self._sink = sink

    def guard(self, member: BusInput | LineInput, action: Callable[[], None]) -> None:
        """Run one port action; on PortError close the link and plan to open it again."""
        try:
            action()
        except PortError as error:
            now_ns = self._clock.now_ns()
            member.link.lose(now_ns)
            text = f"{member.link.name} lost: {error}"
            self._sink.event(Event(now_ns, "high", "PORT_LOST", text))

    def retry(self, member: BusInput | LineInput) -> None:
        """Open a lost link again when its backoff is over, and start its devices."""
        if member.link.up or not member.link.retry(self._clock.now_ns()):
            return
        text = f"{member.link.name} is back"
        self._sink.event(Event(self._clock.now_ns(), "medium", "PORT_BACK", text))
        self.guard(member, member.start_nodes if isinstance(member, BusInput) else member.start)
