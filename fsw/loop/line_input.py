"""A serial device as an input of the loop: link, and what was read but not handed over yet."""

from fsw.drivers.wire import ByteChunk, BytePort
from fsw.exchange.sinks import SerialTraffic, Sink
from fsw.loop.link import Link


class LineInput:
    """One serial device: bytes in, and the bytes that ask it to talk."""

    def __init__(self, name: str, link: Link[BytePort], start_bytes: bytes = b"") -> None:
        self.name = name
        self.link = link
        self.links = (link,)
        self._start_bytes = start_bytes
        self._read: list[ByteChunk] = []
        self._taken: list[ByteChunk] = []  # for a batch

    def start(self) -> None:
        """Ask the device for its data. Raises PortError."""
        if self._start_bytes and self.link.port is not None:
            self.link.port.write(self._start_bytes)

    def drain(self) -> None:
        """Read and stamp the bytes that are there. Raises PortError."""
        if self.link.port is not None:
            self._read += self.link.port.read()

    def take(self) -> None:
        """End a batch: what was drained until now belongs to it."""
        self._taken, self._read = self._read, []

    def hand_over(self, sink: Sink) -> None:
        """Hand over the batch."""
        if self._taken:
            sink.put(SerialTraffic(self.name, self._taken))
