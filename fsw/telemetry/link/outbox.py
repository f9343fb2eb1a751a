"""Bounded queue of the packets for one ground client, ordered by priority."""

from collections import deque
from collections.abc import Callable
from enum import IntEnum

WIRE_BYTES = 16384  # size of the packets of one send, which no later packet overtakes


class Priority(IntEnum):
    """Order of packets for a client that reads more slowly than packets are made."""

    HEALTH = 0  # the health set, verification reports, time
    EVENT = 1
    ANSWER = 2
    HOUSEKEEPING = 3
    DUMP = 4  # logs, lists, files
    SCIENCE = 5


class Outbox:
    """Queues the packets of one client.

    While the client reads fast enough, packets are sent in the order in which they were made. Once
    packets had to wait, the highest priority is sent first until the queue is empty. A full
    outbox drops the oldest packets of lower priority than the new one, or else the new one.

    Parameters
    ----------
    limit_bytes : largest size of the waiting packets [B]
    seal : returns the bytes on the wire for a packet; called in the order of sending
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
        """Return whether any packet waits."""
        return self._bytes > 0

    @property
    def waiting_bytes(self) -> int:
        """Return the size of the waiting packets [B]."""
        return self._bytes

    def put(self, packet: bytes, priority: Priority) -> int:
        """Add a packet; return how many packets were dropped because the outbox is full."""
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
        """Return the next bytes to send; empty if no packet waits."""
        size = sum(map(len, self._wire))
        while size < WIRE_BYTES and (queue := self._next_queue()) is not None:
            _, packet = queue.popleft()
            sealed = self._seal(packet)
            self._wire.append(sealed)
            self._bytes += len(sealed) - len(packet)
            size += len(sealed)
        return b"".join(self._wire)

    def sent(self, count: int) -> int:
        """Remove the first `count` bytes, now sent; return how many packets this completed."""
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
        """Record that the client accepts no bytes now: priority then orders waiting packets."""
        self._is_behind = bool(self)

    def _next_queue(self) -> deque[tuple[int, bytes]] | None:
        waiting = [queue for queue in self._queues if queue]
        if not waiting:
            return None
        return waiting[0] if self._is_behind else min(waiting, key=lambda queue: queue[0][0])
