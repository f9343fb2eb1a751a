"""Packets that wait for one ground client: by priority, bounded, dropped in whole packets only."""

from collections import deque
from collections.abc import Callable
from enum import IntEnum

WIRE_BYTES = 16384  # chosen for sending together; what comes later cannot overtake them


class Priority(IntEnum):
    """Order of packets for a client that reads more slowly than packets are made."""

    HEALTH = 0  # the health set, verification reports, time
    EVENT = 1
    ANSWER = 2
    HOUSEKEEPING = 3
    DUMP = 4  # logs, lists, files
    SCIENCE = 5


class Outbox:
    """Packets of one client.

    As long as the client keeps up, packets go in the order in which they were made. Once some
    had to wait, those of the highest priority go first, until nothing waits any more. A full
    outbox drops the oldest packets of lower priority than the new one, or else the new one.

    Parameters
    ----------
    limit_bytes : that may wait
    seal : makes of a packet what goes over the wire, at the last moment: in the order of sending
    """

    def __init__(
        self, limit_bytes: int, seal: Callable[[bytes], bytes] = lambda packet: packet
    ) -> None:
        self._limit_bytes, self._seal = limit_bytes, seal
        self._queues: tuple[deque[tuple[int, bytes]], ...] = tuple(deque() for _ in Priority)
        self._wire: deque[bytes] = deque()
        self._made = 0
        self._bytes = 0
        self._is_behind = False

    def __bool__(self) -> bool:
        """Whether anything waits."""
        return self._bytes > 0

    @property
    def waiting_bytes(self) -> int:
        """Bytes that wait."""
        return self._bytes

    def put(self, packet: bytes, priority: Priority) -> int:
        """Add a packet; return how many were dropped for want of room."""
        dropped = 0
        while self._bytes + len(packet) > self._limit_bytes:
            lower = next((q for q in reversed(self._queues[priority + 1 :]) if q), None)
            dropped += 1
            if lower is None:
                return dropped
            self._bytes -= len(lower.popleft()[1])
        self._queues[priority].append((self._made, packet))
        self._made += 1
        self._bytes += len(packet)
        return dropped

    def next_bytes(self) -> bytes:
        """Return the next bytes to send; empty when nothing waits."""
        size = sum(map(len, self._wire))
        while size < WIRE_BYTES and (queue := self._next_queue()) is not None:
            _, packet = queue.popleft()
            sealed = self._seal(packet)
            self._wire.append(sealed)
            self._bytes += len(sealed) - len(packet)
            size += len(sealed)
        return b"".join(self._wire)

    def sent(self, count: int) -> int:
        """Remove the first bytes; return how many packets are now sent whole."""
        self._bytes -= count
        whole = 0
        while count:
            packet = self._wire[0]
            if len(packet) > count:
                self._wire[0] = packet[count:]
                break
            count -= len(packet)
            self._wire.popleft()
            whole += 1
        return whole

    def rest(self) -> None:
        """Note that the client takes no more for now."""
        self._is_behind = bool(self)

    def _next_queue(self) -> deque[tuple[int, bytes]] | None:
        waiting = [queue for queue in self._queues if queue]
        if not waiting:
            return None
        return waiting[0] if self._is_behind else min(waiting, key=lambda queue: queue[0][0])
