"""All of a daemon's links: started, drained, lost and opened again.

A link's failure never reaches the loop.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

from fsw.clock import Clock
from fsw.config import Config
from fsw.drivers.wire import BytePort, FramePort
from fsw.exchange.sinks import Sink
from fsw.loop.bus_input import BusInput
from fsw.loop.line_input import LineInput
from fsw.loop.link import Link
from fsw.loop.ports import CAN
from fsw.messages import Event
from fsw.messages.errors import PortError

BATCHES_TO_LOSE = 4  # a bus of a pair is lost after no fewer batches without a frame


def batch_s(config: Config) -> float:
    """Return how long a batch is [s]: shorter where a bus is lost after so little."""
    lost_s = [bus.redundant.lost_after_s for bus in config.buses if bus.redundant is not None]
    return min([config.scheduler.batch_s, *(s / BATCHES_TO_LOSE for s in lost_s)])


class Inputs:
    """Buses and serial lines; what they give goes into the sink."""

    def __init__(
        self, buses: Sequence[BusInput], lines: Sequence[LineInput], clock: Clock, sink: Sink
    ) -> None:
        self.buses, self.lines = tuple(buses), tuple(lines)
        self._clock, self._sink = clock, sink
        self._started = False

    def __iter__(self) -> Iterator[BusInput | LineInput]:
        yield from self.buses
        yield from self.lines

    def start(self) -> None:
        """Start every device, once."""
        if self._started:
            return
        self._started = True
        for bus in self.buses:
            self._guard(bus.link, bus.start_nodes)
        for line in self.lines:
            self._guard(line.link, line.start)

    def sync(self, bus: BusInput) -> None:
        """Send a bus its SYNC."""
        self._guard(bus.link, bus.send_sync)

    def beat(self, bus: BusInput) -> None:
        """Send a bus the heartbeat."""
        self._guard(bus.link, bus.send_heartbeat)

    def drain(self) -> None:
        """Drain the buses; change to the other bus of a pair where it must be.

        The bytes of lines are read when they come.
        """
        for bus in self.buses:
            self._guard(bus.link, bus.drain)
            if bus.select(self._sink):
                self._guard(bus.link, bus.start_nodes)
                self._guard(bus.link, bus.send_heartbeat)

    def hand_over(self) -> Iterator[None]:
        """Hand over what has come until the first of four steps, in order."""
        self.stamp_lines()
        for line in self.lines:
            line.take()
        for bus in self.buses:
            self._guard(bus.link, bus.take)
            for link in bus.idle_links:
                self._guard(link, partial(bus.drain_idle, link))
        yield
        for bus in self.buses:
            bus.read()
        yield
        for bus in self.buses:
            bus.order()
        yield
        for bus in self.buses:
            self._guard(bus.link, partial(bus.hand_over, self._sink))
        for line in self.lines:
            line.hand_over(self._sink)

    def take_held_ns(self) -> int:
        """Return and forget how long the kernel held the loop in sends that took far too long."""
        return sum(bus.take_held_ns() for bus in self.buses)

    def lost(self) -> tuple[str, ...]:
        """Return the names of the inputs that have no port."""
        return tuple(member.name for member in self if not member.link.up)

    def status(self) -> dict[str, Any]:
        """Return the state of links and buses as plain values."""
        links = [link for member in self for link in member.links]
        return {
            "links": {link.name.removeprefix(CAN): link.summary() for link in links},
            "buses": {bus.name: bus.summary() for bus in self.buses},
        }

    def retry(self) -> None:
        """Open lost links again as soon as they can be, and start their devices."""
        for member in self:
            for link in member.links:
                if link.up or not link.retry(self._clock.now_ns()):
                    continue
                text = f"{link.name} is back"
                self._sink.put(Event(self._clock.now_ns(), "medium", "PORT_BACK", text))
                if isinstance(member, LineInput):
                    self._guard(link, member.start)
                elif link is member.link:
                    self._guard(link, member.start_nodes)

    def wake_fds(self) -> list[int]:
        """Return the descriptors whose bytes end the wait for a tick."""
        return [fd for line in self.lines for fd in line.link.wake_fds()]

    def stamp_lines(self) -> None:
        """Read the serial lines between two ticks, so that their bytes have a time of their own."""
        for line in self.lines:
            self._guard(line.link, line.drain)

    def close(self) -> None:
        """Release every port."""
        for member in self:
            for link in member.links:
                link.close()

    def _guard(self, link: Link[FramePort] | Link[BytePort], action: Callable[[], None]) -> None:
        """Run one action on a port; on PortError close the link and plan to open it again."""
        try:
            action()
        except PortError as error:
            for bus in self.buses:
                if bus.link is link:
                    bus.keep()
            now_ns = self._clock.now_ns()
            link.lose(now_ns)
            self._sink.put(Event(now_ns, "high", "PORT_LOST", f"{link.name} lost: {error}"))
