"""Conversion of one port's kernel stamps to CLOCK_MONOTONIC."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fsw.clock import Clock, monotonic_less_realtime_ns

KERNEL_WAIT_NS = 20_000_000  # longest wait of a stamped frame in the kernel's queues; 16 ms seen
SET_NS = 100_000  # if the offset of the two clocks changes by more, one of them was set
DOUBT_NS = 100_000_000  # time for which stamps are doubted after that


class KernelStamps:
    """Converts stamps from CLOCK_REALTIME to CLOCK_MONOTONIC, never later than now.

    A converted stamp is wrong if CLOCK_REALTIME was set after the frame was stamped. The start of
    the last read that left the port empty is a lower bound of a frame's time. The bound is rough:
    a stamped frame may wait in the kernel's queues while a read finds nothing. Therefore the bound
    replaces every earlier time for `DOUBT_NS` after the clock was set, and otherwise only a time
    more than `KERNEL_WAIT_NS` before the bound.

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
        """Record the start [ns, CLOCK_MONOTONIC] of a read that left nothing waiting."""
        self._empty_ns = began_ns

    def monotonic_ns(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the times (k,) of the stamps of a batch that was read just now."""
        offset_ns, now_ns = self._compare(), self._clock.now_ns()
        if abs(offset_ns - self._offset_ns) > SET_NS:
            self._doubted_until_ns = now_ns + DOUBT_NS
        self._offset_ns = offset_ns
        trusted_ns = self._empty_ns - (KERNEL_WAIT_NS if now_ns >= self._doubted_until_ns else 0)
        times_ns = stamps_ns + offset_ns
        times_ns[times_ns < trusted_ns] = self._empty_ns
        return np.minimum(times_ns, now_ns)
