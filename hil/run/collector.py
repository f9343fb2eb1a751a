"""A sink that keeps results of a run; those of a long run are in a file."""

from fsw.drivers.wire import ByteChunk
from fsw.exchange.sinks import Message, NullSink, SerialTraffic
from fsw.messages import Block, Estimate, Event
from offline.shelf import Shelf


class Collector(NullSink):
    """Keeps the results that the score and the picture need."""

    def __init__(self) -> None:
        self.estimates: Shelf[Estimate] = Shelf()
        self.blocks: Shelf[Block] = Shelf()
        self.imu_chunks: Shelf[ByteChunk] = Shelf()
        self.events: list[Event] = []

    def put(self, message: Message) -> None:
        """Keep estimates, blocks, events, and the bytes of the inertial unit."""
        match message:
            case SerialTraffic(device="imu"):
                for chunk in message.chunks:
                    self.imu_chunks.append(chunk)
            case Block():
                self.blocks.append(message)
            case Estimate():
                self.estimates.append(message)
            case Event():
                self.events.append(message)
            case _:
                return

    @property
    def codes(self) -> list[str]:
        """Codes of the events, in order."""
        return [event.code for event in self.events]
