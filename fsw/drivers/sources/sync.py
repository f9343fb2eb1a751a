"""History of the SYNCs of one bus, which time the samples of its nodes."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.config import BusConfig
from fsw.drivers.codecs.canopen import COB_SYNC, decode_sync
from fsw.drivers.sources.sync_pace import SyncPace
from fsw.drivers.wire import FrameArray, Reject
from fsw.messages import IntArray

MAX_AGE_S = 0.4
CYCLE_RATIO = 0.9  # of a counter cycle: an older SYNC could be of another cycle
UNKNOWN = -1
BEFORE = -1  # row of a SYNC that came in an earlier batch


class Matched(NamedTuple):
    """The SYNCs of k answers; all arrays (k,)."""

    sync: IntArray  # running index of the SYNC, UNKNOWN if no SYNC matches or it is too old
    stamp_ns: IntArray  # stamp of that SYNC
    newest: IntArray  # running index of the newest SYNC before the answer
    crept: NDArray[np.bool_]  # whether the stamp has crept, so that the answer has no time


class SyncHistory:
    """The latest SYNCs in order: counter, stamp and running index; and whether stamps creep."""

    def __init__(self, counter_max: int, rate_hz: float, pace: SyncPace | None = None) -> None:
        self._pace = pace or SyncPace(rate_hz)
        self._counter_max = counter_max
        self._max_age_ns = round(min(MAX_AGE_S, CYCLE_RATIO * counter_max / rate_hz) * 1e9)
        self._latest: list[int | None] = [None] * (counter_max + 1)  # stamp by counter
        self._counters = np.empty(0, np.int64)
        self._stamps_ns = np.empty(0, np.int64)
        self._rows = np.empty(0, np.int64)  # row in the newest batch, or BEFORE
        self._new: list[tuple[int, int, int]] = []  # counter, stamp, row
        self._echo_ns = 0.5e9 * counter_max / rate_hz
        self._last_counter = 0
        self.echoes = 0  # SYNCs seen twice: as sent, and as the bus handed them back
        self.count = 0
        self.lost = 0  # SYNCs missing by their counter
        self.invalid = 0

    def add(self, data: bytes, t_ns: int, row: int) -> bool:
        """Accept the SYNC in a row of the batch; return False for an echo or an invalid counter."""
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
        self._latest[counter] = t_ns
        self._new.append((counter, t_ns, row))
        self.count += 1
        return True

    def note(self, frames: FrameArray) -> None:
        """Accept the SYNCs of a batch."""
        rows = np.flatnonzero(frames["word"] == COB_SYNC)
        own = frames.take(rows)
        places, stamps_ns = rows.tolist(), own["t_ns"].tolist()
        is_plain = bool((own["length"] == 1).all())
        if not (is_plain and self.follow(own["data"][:, 0].tolist(), stamps_ns, places)):
            for k, (row, t_ns) in enumerate(zip(places, stamps_ns, strict=True)):
                self.add(own["data"][k, : own["length"][k]].tobytes(), t_ns, row)

    def follow(self, counters: list[int], stamps_ns: list[int], rows: list[int]) -> bool:
        """Accept SYNCs with consecutive counters; else return False and change nothing.

        The result is that of `add` called one by one: no SYNC is an echo, and none is missing.
        """
        if not counters:
            return True
        before, last = self._last_counter, self._counter_max
        expected = [(before + k) % last + 1 for k in range(len(counters))]
        if not self.count or last < 2 or counters != expected:
            return False
        for counter, t_ns in zip(counters, stamps_ns, strict=True):
            self._latest[counter] = t_ns
        self._new += zip(counters, stamps_ns, rows, strict=True)
        self._last_counter = counters[-1]
        self.count += len(counters)
        return True

    def _is_echo(self, counter: int, t_ns: int) -> bool:
        """Return whether this SYNC repeats the newest one, or a recent one whose echo came late."""
        behind = (self._last_counter - counter) % self._counter_max
        before = self._latest[counter]
        recent = before is not None and t_ns - before < self._echo_ns
        return recent and behind < max(1, self._counter_max // 4)

    def match(self, counters: IntArray, rows: IntArray, t_ns: IntArray) -> Matched:
        """Find the SYNC of every answer in a batch: the latest one before with the same counter.

        Parameters
        ----------
        counters, rows, t_ns : (k,) echoed counter, row in the batch and stamp of every answer
        """
        self._take_new()
        held = self._counters
        if not held.size:
            none = np.full(len(counters), UNKNOWN)
            return Matched(none, np.zeros(len(counters), np.int64), none, none >= 0)
        last = np.searchsorted(self._rows, rows) - 1
        # an answer is to its newest SYNC, or to the one before
        at = last - (held[last] != counters)
        if at.min(initial=0) >= 0 and not np.count_nonzero(held[at] != counters):
            found = np.ones(len(at), np.bool_)
        else:
            at, found = _latest(held, counters, last)
        stamps_ns = self._stamps_ns[np.where(found, at, 0)]
        found &= t_ns - stamps_ns <= self._max_age_ns
        first = self.count - held.size
        index, newest = np.where(found, first + at, UNKNOWN), first + last
        self._pace.follow(index[found], newest[found], stamps_ns[found], t_ns[found])
        return Matched(index, stamps_ns, newest, found & self._pace.crept(index))

    @property
    def movement(self) -> str:
        """How far the stamps have crept, in words."""
        return f"stamps of SYNC have moved by {self._pace.moved_ns * 1e-3:.0f} us"

    def _take_new(self) -> None:
        """Append the SYNCs of this batch to the held ones; discard SYNCs too old to be echoed."""
        new = np.array(self._new, np.int64).reshape(-1, 3)
        self._new = []
        # every answer of this batch came after the newest SYNC of the batches before
        before_ns = self._stamps_ns[-1] if self._stamps_ns.size else 0
        start = int(np.searchsorted(self._stamps_ns, before_ns - self._max_age_ns))
        self._counters = np.concatenate([self._counters[start:], new[:, 0]])
        self._stamps_ns = np.concatenate([self._stamps_ns[start:], new[:, 1]])
        old = np.full(len(self._rows) - start, BEFORE)
        self._rows = np.concatenate([old, new[:, 2]])


def history_of(bus: BusConfig) -> SyncHistory:
    """Return the empty history of a configured bus."""
    pace = SyncPace(bus.rate_hz, bus.bitrate, own=bus.sync == "producer")
    return SyncHistory(bus.sync_counter_max, bus.rate_hz, pace)


def _latest(
    held: IntArray, counters: IntArray, last: NDArray[np.intp]
) -> tuple[IntArray, NDArray[np.bool_]]:
    """Return, per answer, the place of the latest equal counter up to `last`, and if it exists."""
    keys = np.sort(held * held.size + np.arange(held.size))  # by counter, then in order
    near = np.searchsorted(keys, counters * held.size + last, side="right") - 1
    found = (near >= 0) & (keys[near] // held.size == counters)
    return keys[near] % held.size, found
