"""A serial line of an inertial unit with known truth: bytes, wire times, chunkings."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fsw.drivers.wire import ByteChunk
from tests.support.encoders import Stim

Floats = NDArray[np.float64]
Polls = Callable[[Floats, int, np.random.Generator], Floats]
RATE_HZ = 500
BYTE_NS = 10e9 / 921600
FIRST_COUNTER = 7


class Line:
    """A unit whose clock is off by `ppm`; sample k is valid at `valid_ns[k]`."""

    def __init__(self, duration_s: float, ppm: float, rng: np.random.Generator) -> None:
        count = int(duration_s * RATE_HZ)
        period_ns = 1e9 / RATE_HZ * (1 + 1e-6 * ppm)
        self.valid_ns = 5e15 + rng.uniform(0, 2e6) + period_ns * np.arange(count)
        latency_us = 1000 + rng.integers(0, 50, count)
        self.datagrams = [
            Stim(0xA5, {"g": (k, -k, 1), "a": (1, 2, k)}, counter=FIRST_COUNTER + 4 * k,
                 latency_us=int(us)).encode()
            for k, us in enumerate(latency_us)
        ]  # fmt: skip
        size = len(self.datagrams[0])
        start_ns = self.valid_ns + 1e3 * latency_us
        self.byte_ns = (start_ns[:, None] + BYTE_NS * (1 + np.arange(size))).ravel()
        self.size = size

    def chunks(self, polls_ns: Floats) -> list[ByteChunk]:
        """Return what reads at these times give: every byte that has come by then."""
        data = b"".join(self.datagrams)
        stops = np.searchsorted(self.byte_ns, polls_ns, side="right")
        out, start = [], 0
        for t_ns, stop in zip(polls_ns, stops.tolist(), strict=True):
            if stop > start:
                out.append(ByteChunk(int(t_ns), data[start:stop]))
                start = stop
        return out


def each_datagram(delay_ns: float) -> Polls:
    def polls(byte_ns: Floats, size: int, rng: np.random.Generator) -> Floats:
        ends = byte_ns[size - 1 :: size]
        return np.maximum.accumulate(ends + rng.exponential(delay_ns, len(ends)))

    return polls


def random_splits(ratio: float, delay_ns: float) -> Polls:
    def polls(byte_ns: Floats, _size: int, rng: np.random.Generator) -> Floats:
        ends = byte_ns[rng.random(len(byte_ns)) < ratio]
        return np.maximum.accumulate(ends + rng.exponential(delay_ns, len(ends)))

    return polls


def grid(period_ns: float, jitter_ns: float) -> Polls:
    def polls(byte_ns: Floats, _size: int, rng: np.random.Generator) -> Floats:
        start = byte_ns[0] + rng.uniform(0, period_ns)
        ticks = np.arange(start, byte_ns[-1] + period_ns, period_ns)
        return np.sort(ticks + rng.uniform(0, jitter_ns, len(ticks)))

    return polls


def poisson(mean_ns: float) -> Polls:
    def polls(byte_ns: Floats, _size: int, rng: np.random.Generator) -> Floats:
        span = byte_ns[-1] - byte_ns[0]
        return byte_ns[0] + np.cumsum(rng.exponential(mean_ns, int(1.3 * span / mean_ns) + 9))

    return polls
