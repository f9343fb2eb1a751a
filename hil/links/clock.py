"""Simulated monotonic time, which passes only in sleeps; serial arrivals end a sleep early."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np


class SimClock:
    """The flight software's clock port, in virtual time.

    `register` returns a descriptor for a function that returns when a link is next readable. A
    wake-up follows its cause after an exponential delay, `wake_latency_s` on average.
    """

    def __init__(self, t0_ns: int, rng: np.random.Generator, wake_latency_s: float) -> None:
        self._now_ns = t0_ns
        self._latencies_ns = _exponential_draws(rng, wake_latency_s * 1e9)
        self._sources: dict[int, Callable[[], int | None]] = {}

    def register(self, next_ns: Callable[[], int | None]) -> int:
        """Return a descriptor of a link that is next readable at `next_ns()` (None: never)."""
        descriptor = 1000 + len(self._sources)
        self._sources[descriptor] = next_ns
        return descriptor

    def now_ns(self) -> int:
        """Return simulated time [ns]."""
        return self._now_ns

    def cpu_time_ns(self) -> int:
        """Return 0: work takes no simulated time."""
        return 0

    def sleep_until_ns(self, deadline_ns: int, wake_fds: Sequence[int] = ()) -> bool:
        """Advance the time to the deadline, or to just after the first arrival on a descriptor.

        Returns
        -------
        True if the deadline is reached, False if an arrival ended the sleep early.
        """
        if deadline_ns <= self._now_ns:
            return True
        arrival_ns = deadline_ns
        for fd in wake_fds:
            next_ns = self._sources[fd]()
            if next_ns is not None and next_ns < arrival_ns:
                arrival_ns = next_ns
        if arrival_ns < deadline_ns:
            wake_ns = max(arrival_ns, self._now_ns) + round(next(self._latencies_ns))
            if wake_ns < deadline_ns:
                self._now_ns = wake_ns
                return False
        self._now_ns = deadline_ns
        return True


def _exponential_draws(rng: np.random.Generator, mean: float) -> Iterator[float]:
    while True:
        yield from rng.exponential(mean, 1024).tolist()
