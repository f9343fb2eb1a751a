"""A serial device as an input of the loop: link + source + what was read but not accepted yet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from fsw.drivers.wire import ByteChunk, BytePort
from fsw.exchange.sinks import SerialTraffic, Sink
from fsw.loop.link import Link
from fsw.messages import Samples
from fsw.messages.findings import Finding


class ChunkSource(Protocol):
    """Codec and counters of one serial device."""

    @property
    def counters(self) -> dict[str, int]:
        """Counters by name."""
        ...

    def feed(self, chunks: Sequence[ByteChunk]) -> Samples:
        """Decode chunks in order."""
        ...

    def findings(self) -> Sequence[Finding]:
        """Return and forget what was found wrong."""
        ...

    def watch(self, now_ns: int, *, up: bool) -> None:
        """Look whether the device has fallen silent; `up`: whether it has its port."""
        ...


class LineInput:
    """One serial device: bytes in, and the bytes that ask it to talk.

    `is_sampled`: the chunks are samples that another program decoded, no bytes of a line.
    """

    def __init__(
        self,
        name: str,
        link: Link[BytePort],
        source: ChunkSource,
        start_bytes: bytes,
        *,
        is_sampled: bool = False,
    ) -> None:
        self.name = name
        self.link = link
        self.links = (link,)
        self.source = source
        self.is_sampled = is_sampled
        self._start_bytes = start_bytes
        self._read: list[ByteChunk] = []
        self._accepted: list[ByteChunk] = []

    @property
    def waiting(self) -> int:
        """Chunks drained and not accepted yet."""
        return len(self._read)

    def start(self) -> None:
        """Ask the device for its data. Raises PortError."""
        if self._start_bytes and self.link.port is not None:
            self.link.port.write(self._start_bytes)

    def drain(self) -> None:
        """Read and stamp what is there. Raises PortError."""
        if self.link.port is not None:
            self._read += self.link.port.read()

    def accept(self, sink: Sink) -> None:
        """Record what was drained."""
        self._accepted, self._read = self._read, []
        if self._accepted:
            sink.put(SerialTraffic(self.name, self._accepted))

    def first_ns(self) -> int | None:
        """Stamp of the first of what was accepted [ns]."""
        return self._accepted[0].t_ns if self._accepted else None

    def feed(self) -> Samples | None:
        """Decode what was accepted; None where that was nothing."""
        accepted, self._accepted = self._accepted, []
        return self.source.feed(accepted) if accepted else None

    def findings(self) -> Sequence[Finding]:
        """Return and forget what was found wrong."""
        return self.source.findings()

    def watch(self, now_ns: int) -> None:
        """Look whether the device has fallen silent; a lost port is an event of its own."""
        self.source.watch(now_ns, up=self.link.up)
