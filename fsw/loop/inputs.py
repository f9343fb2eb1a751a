"""All links of a daemon: devices are started, ports are drained, lost ports are opened again.

A PortError of one link is handled here and never reaches the loop.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

from fsw.clock import Clock
from fsw.config import Config
from fsw.drivers.wire import BytePort, FramePort
from fsw.errors import PortError
from fsw.exchange.sinks import Sink
from fsw.loop.bus_input import BusInput
from fsw.loop.line_input import LineInput
from fsw.loop.link import Link
from fsw.loop.ports import CAN
from fsw.messages import Event

BATCHES_TO_LOSE = 4  # least number of batches in the time after which a silent bus is lost


def batch_s(config: Config) -> float:
    """Return the length of a batch [s]: `BATCHES_TO_LOSE` batches fit into each `lost_after_s`."""
    lost_s = [bus.redundant.lost_after_s for bus in config.buses if bus.redundant is not None]
    return min([config.scheduler.batch_s, *(s / BATCHES_TO_LOSE for s in lost_s)])


class Inputs:
    """The buses and serial lines of a daemon; their traffic goes into the sink."""

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
        """Start every device at the first call; later calls do nothing."""
        if self._started:
            return
        self._started = True
        for bus in self.buses:
            self._guard(bus.link, bus.start_nodes)
        for line in self.lines:
            self._guard(line.link, line.start)

    def sync(self, bus: BusInput) -> None:
        """Send the next SYNC on a bus."""
        self._guard(bus.link, bus.send_sync)

    def beat(self, bus: BusInput) -> None:
        """Send the computer's heartbeat on a bus."""
        self._guard(bus.link, bus.send_heartbeat)

    def drain(self) -> None:
        """Drain the buses; switch a redundant pair to its other bus if the active one is lost.

        `stamp_lines` reads the serial lines.
        """
        for bus in self.buses:
            self._guard(bus.link, bus.drain)
            if bus.select(self._sink):
                self._guard(bus.link, bus.start_nodes)
                self._guard(bus.link, bus.send_heartbeat)

    def hand_over(self) -> Iterator[None]:
        """Hand over a batch in four steps; the first step ends the batch."""
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
        """Return the total time of sends that took far too long since the last call [ns]."""
        return sum(bus.take_held_ns() for bus in self.buses)

    def lost(self) -> tuple[str, ...]:
        """Return the names of the inputs whose active link has no open port."""
        return tuple(member.name for member in self if not member.link.up)

    def status(self) -> dict[str, Any]:
        """Return the state of links and buses as plain values."""
        links = [link for member in self for link in member.links]
        return {
            "links": {link.name.removeprefix(CAN): link.summary() for link in links},
            "buses": {bus.name: bus.summary() for bus in self.buses},
        }

    def retry(self) -> None:
        """Try to open lost links; start the devices of a link that is open again."""
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
        """Return the descriptors of the serial lines: their bytes interrupt the wait for a tick."""
        return [fd for line in self.lines for fd in line.link.wake_fds()]

    def stamp_lines(self) -> None:
        """Read the serial lines between two ticks, so that bytes are stamped when they arrive."""
        for line in self.lines:
            self._guard(line.link, line.drain)

    def close(self) -> None:
        """Release every port."""
        for member in self:
            for link in member.links:
                link.close()

    def _guard(self, link: Link[FramePort] | Link[BytePort], action: Callable[[], None]) -> None:
        """Run one action on a port; on PortError close the link and report PORT_LOST."""
        try:
            action()
        except PortError as error:
            for bus in self.buses:
                if bus.link is link:
                    bus.keep()
            now_ns = self._clock.now_ns()
            link.lose(now_ns)
            self._sink.put(Event(now_ns, "high", "PORT_LOST", f"{link.name} lost: {error}"))
