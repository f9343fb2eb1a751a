"""A serial line: the time of each byte, and the chunks in which the host receives bytes."""

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil.world.sensor_config import Chunking

TimedBytes = tuple[int, bytes]
GRID_NS = 1_000_000
MEAN_GAP_NS = 1_500_000.0


class SerialLine:
    """Device-to-host direction of one line, 8N1.

    Chunkings: `datagram` delivers a transmission when its last byte ends; `ms1` delivers at every
    1 ms of a clock with an error of at most `clock_ppm`; `random` delivers at random instants,
    anywhere in a datagram. No byte is delivered before it has ended on the wire.
    """

    def __init__(
        self,
        baud_rate: int,
        chunking: Chunking,
        rng: np.random.Generator,
        t0_ns: int,
        clock_ppm: float = 0.0,
    ) -> None:
        self.byte_ns = 10e9 / baud_rate
        self._chunking = chunking
        self._rng = rng
        self._ready: deque[TimedBytes] = deque()
        self._times: list[NDArray[np.int64]] = []
        self._bytes: list[bytes] = []
        self._cuts: deque[int] = deque()
        self._last_cut = t0_ns + float(rng.uniform(0.0, GRID_NS))
        self._step = GRID_NS * (1.0 + 1e-6 * float(rng.uniform(-1.0, 1.0)) * clock_ppm)
        self.busy_until_ns = t0_ns

    def duration_ns(self, count: int) -> int:
        """Return the time that `count` bytes need on the wire [ns]."""
        return round(count * self.byte_ns)

    def send(self, starts_ns: Sequence[int], blocks: Sequence[bytes]) -> None:
        """Transmit blocks whose first bits start at `starts_ns` (in order, not overlapping)."""
        ends = [
            start + self.duration_ns(len(b)) for start, b in zip(starts_ns, blocks, strict=True)
        ]
        if not ends:
            return
        self.busy_until_ns = ends[-1]
        if self._chunking == "datagram":
            self._ready.extend(zip(ends, blocks, strict=True))
            return
        for start, block in zip(starts_ns, blocks, strict=True):
            steps = np.rint(np.arange(1, len(block) + 1) * self.byte_ns).astype(np.int64)
            self._times.append(start + steps)
        self._bytes.extend(blocks)

    def complete(self, until_ns: int) -> None:
        """Make the chunks up to `until_ns`; no later `send` may have a byte that ends before."""
        if self._chunking == "datagram" or not self._bytes:
            return
        times, data = np.concatenate(self._times), b"".join(self._bytes)
        done = 0
        while done < len(data):
            cut = self._cut_at(int(times[done]))
            if cut > until_ns:
                break
            stop = int(np.searchsorted(times, cut, side="right"))
            self._ready.append((cut, data[done:stop]))
            done = stop
        left = done < len(data)
        self._times = [times[done:]] if left else []
        self._bytes = [data[done:]] if left else []

    def _cut_at(self, t_ns: int) -> int:
        """Return the first delivery time at or after `t_ns`."""
        while self._cuts and self._cuts[0] < t_ns:
            self._cuts.popleft()
        while not self._cuts:
            gap = self._step if self._chunking == "ms1" else self._rng.exponential(MEAN_GAP_NS)
            self._last_cut += gap
            if self._last_cut >= t_ns:
                self._cuts.append(round(self._last_cut))
        return max(t_ns, self._cuts[0])

    def next_ns(self) -> int | None:
        """Return the delivery time of the next known chunk [ns]; None if no byte waits."""
        if self._ready:
            return self._ready[0][0]
        return self._cut_at(int(self._times[0][0])) if self._times else None

    def take(self, until_ns: int) -> list[TimedBytes]:
        """Return the chunks delivered by this time, with their delivery times [ns]."""
        chunks = []
        while self._ready and self._ready[0][0] <= until_ns:
            chunks.append(self._ready.popleft())
        return chunks
