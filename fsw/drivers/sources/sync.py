"""History of the SYNCs of one bus: the joints' time."""

from __future__ import annotations

from fsw.drivers.codecs.canopen import decode_sync
from fsw.drivers.wire import Reject

MAX_AGE_S = 0.4
CYCLE_RATIO = 0.9  # of a counter cycle: an older match could be of another cycle


class SyncHistory:
    """Stamps of the latest SYNCs by counter, each with its running index."""

    def __init__(self, counter_max: int, rate_hz: float) -> None:
        self._counter_max = counter_max
        self._max_age_ns = round(min(MAX_AGE_S, CYCLE_RATIO * counter_max / rate_hz) * 1e9)
        self._latest: list[tuple[int, int] | None] = [None] * (counter_max + 1)
        self._before: list[tuple[int, int] | None] = [None] * (counter_max + 1)
        self._echo_ns = 0.5e9 * counter_max / rate_hz
        self._last_counter = 0
        self._issued = 0  # counter of the last one sent from here
        self.echoes = 0  # the same SYNC seen again: as sent, and as the bus handed it back
        self.count = 0
        self.lost = 0  # gaps in the counter as seen here
        self.invalid = 0

    def add(self, data: bytes, t_ns: int) -> bool:
        """Accept a SYNC; False when it is an echo or carries no counter of this bus."""
        counter = decode_sync(data, self._counter_max)
        if isinstance(counter, Reject):
            self.invalid += 1
            return False
        if self.count:
            if self._is_echo(counter, t_ns):
                self.echoes += 1
                return False
            self.lost += (counter - self._last_counter - 1) % self._counter_max
        self._last_counter = counter
        self._before[counter] = self._latest[counter]
        self._latest[counter] = (t_ns, self.count)
        self.count += 1
        return True

    def _is_echo(self, counter: int, t_ns: int) -> bool:
        """Return whether this SYNC is known: the newest, or one whose repetition came late."""
        behind = (self._last_counter - counter) % self._counter_max
        before = self._latest[counter]
        recent = before is not None and t_ns - before[0] < self._echo_ns
        return recent and behind < max(1, self._counter_max // 4)

    def next_counter(self) -> int:
        """Return the counter that follows the last one sent or, before that, seen."""
        return (self._issued or self._last_counter) % self._counter_max + 1

    def issue(self) -> None:
        """Note that a SYNC with `next_counter` was sent; it may be added much later."""
        self._issued = self.next_counter()

    def find(self, counter: int, t_ns: int) -> tuple[int, int] | None:
        """Return stamp and index of the latest SYNC with this counter at or before t_ns."""
        if not 1 <= counter <= self._counter_max:
            return None
        entry = self._latest[counter]
        if entry is not None and entry[0] > t_ns:
            entry = self._before[counter]
        if entry is None or not 0 <= t_ns - entry[0] <= self._max_age_ns:
            return None
        return entry
