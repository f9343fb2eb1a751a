"""A serial line: when each byte has crossed, and in which pieces the host gets them."""

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

    Chunkings: `datagram` hands each transmission over as its last byte ends; `ms1` hands over what
    has crossed at each 1 ms frame of a clock up to `clock_ppm` off; `random` cuts at random
    instants, anywhere in a datagram. None is earlier than the wire.
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
        """Return the time `count` bytes take to cross."""
        return round(count * self.byte_ns)

    def send(self, starts_ns: Sequence[int], blocks: Sequence[bytes]) -> None:
        """Transmit blocks whose first bits start at the times (in order, not overlapping)."""
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
        """Declare that no byte ending at or before the time will still be sent: cut chunks."""
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
        """Return the first hand-over instant at or after the time."""
        while self._cuts and self._cuts[0] < t_ns:
            self._cuts.popleft()
        while not self._cuts:
            gap = self._step if self._chunking == "ms1" else self._rng.exponential(MEAN_GAP_NS)
            self._last_cut += gap
            if self._last_cut >= t_ns:
                self._cuts.append(round(self._last_cut))
        return max(t_ns, self._cuts[0])

    def next_ns(self) -> int | None:
        """Return when the next known chunk is handed over."""
        if self._ready:
            return self._ready[0][0]
        return self._cut_at(int(self._times[0][0])) if self._times else None

    def take(self, until_ns: int) -> list[TimedBytes]:
        """Return the chunks handed over up to the time."""
        chunks = []
        while self._ready and self._ready[0][0] <= until_ns:
            chunks.append(self._ready.popleft())
        return chunks
