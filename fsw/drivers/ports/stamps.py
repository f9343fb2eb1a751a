"""The kernel's stamps of one port as times of the monotonic clock."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fsw.clock import Clock, monotonic_less_realtime_ns

KERNEL_WAIT_NS = 20_000_000  # of a stamped frame in the kernel's own queues, at most; 16 ms seen
SET_NS = 100_000  # two clocks that moved further apart than this: one of them was set
DOUBT_NS = 100_000_000  # after that


class KernelStamps:
    """Converts stamps from CLOCK_REALTIME to CLOCK_MONOTONIC, never later than now.

    A converted stamp can be wrong when the system's clock was set in between. Then the last read
    that emptied the port is a lower bound of a frame's time, but a rough one, because a stamped
    frame may wait in the kernel's own queues while a read finds nothing. So the bound applies at
    once for `DOUBT_NS` after the clock was set, and otherwise only to stamps that lie more than
    `KERNEL_WAIT_NS` before it.

    Parameters
    ----------
    compare : returns CLOCK_MONOTONIC - CLOCK_REALTIME [ns]
    """

    def __init__(
        self, clock: Clock, compare: Callable[[], int] = monotonic_less_realtime_ns
    ) -> None:
        self._clock, self._compare = clock, compare
        self._empty_ns = clock.now_ns()
        self._offset_ns = compare()
        self._doubted_until_ns = 0

    def left_empty(self, began_ns: int) -> None:
        """Note that a read which began then [ns, monotonic] left nothing waiting."""
        self._empty_ns = began_ns

    def monotonic_ns(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the times of a batch that was read just now; the clocks are compared once."""
        offset_ns, now_ns = self._compare(), self._clock.now_ns()
        if abs(offset_ns - self._offset_ns) > SET_NS:
            self._doubted_until_ns = now_ns + DOUBT_NS
        self._offset_ns = offset_ns
        trusted_ns = self._empty_ns - (KERNEL_WAIT_NS if now_ns >= self._doubted_until_ns else 0)
        times_ns = stamps_ns + offset_ns
        times_ns[times_ns < trusted_ns] = self._empty_ns
        return np.minimum(times_ns, now_ns)
