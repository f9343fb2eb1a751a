"""A serial device as an input of the loop: its link, and the bytes not handed over yet."""

from fsw.drivers.wire import ByteChunk, BytePort
from fsw.exchange.sinks import SerialTraffic, Sink
from fsw.loop.link import Link


class LineInput:
    """Reads one serial device, and sends the bytes that request its data (`start_bytes`)."""

    def __init__(self, name: str, link: Link[BytePort], start_bytes: bytes = b"") -> None:
        self.name = name
        self.link = link
        self.links = (link,)
        self._start_bytes = start_bytes
        self._read: list[ByteChunk] = []
        self._taken: list[ByteChunk] = []  # the batch that is handed over next

    def start(self) -> None:
        """Send the bytes that request the device's data, if any. Raises PortError."""
        if self._start_bytes and self.link.port is not None:
            self.link.port.write(self._start_bytes)

    def drain(self) -> None:
        """Read and stamp the waiting bytes. Raises PortError."""
        if self.link.port is not None:
            self._read += self.link.port.read()

    def take(self) -> None:
        """End a batch: the bytes drained so far belong to it."""
        self._taken, self._read = self._read, []

    def hand_over(self, sink: Sink) -> None:
        """Put the bytes of the batch into the sink, if there are any."""
        if self._taken:
            sink.put(SerialTraffic(self.name, self._taken))
