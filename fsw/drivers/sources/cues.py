"""Times of validity from other frames on the bus: SYNC, a request of another master, TIME."""

from collections import deque
from collections.abc import Sequence

import numpy as np

from fsw.drivers.sources.clock_model import ClockModel
from fsw.drivers.sources.validity import REFUSED
from fsw.drivers.wire import FrameArray
from fsw.messages import FloatArray, IntArray

COB_TIME = 0x100  # the predefined identifier of TIME
TIME_BYTES = 6  # milliseconds after midnight, of which 28 bits count; days since 1984
TIME_BITS = 47 + 8 * TIME_BYTES  # of its frame, without stuff bits
DAY_MS = 86_400_000
TICK_S = 1e-3  # of TIME
HELD = 256  # cues that are remembered over a batch
FOREVER_NS = 1 << 62
OLD_NS = 60_000_000_000  # a TIME that is older gives no sample a time


class Cues:
    """Frames that make devices measure. They are numbered in order.

    Parameters
    ----------
    words : identifiers with flag bits
    """

    def __init__(self, words: Sequence[int]) -> None:
        self.words = np.array(words, np.uint32)
        self._stamps_ns = np.empty(0, np.int64)
        self.count = 0

    def note(self, t_ns: IntArray) -> None:
        """Accept the cues of a batch by their stamps (k,), in order."""
        self._stamps_ns = np.concatenate([self._stamps_ns[-HELD:], t_ns])
        self.count += len(t_ns)

    def last(self, t_ns: IntArray) -> IntArray:
        """Return the number of the last cue before each of the times (k,); REFUSED: none."""
        at = np.searchsorted(self._stamps_ns, t_ns) - 1
        return np.where(at >= 0, self.count - len(self._stamps_ns) + at, REFUSED)

    def stamps_ns(self, number: IntArray) -> IntArray:
        """Return the stamps of cues by number (k,); 0: no such cue, or it is no longer stored."""
        if not self._stamps_ns.size:
            return np.zeros(len(number), np.int64)
        at = number - (self.count - len(self._stamps_ns))
        return np.where(at < 0, 0, self._stamps_ns[np.maximum(at, 0)])

    def first_ns(self, t_ns: int) -> int:
        """Return the stamp of the first cue at or after a time; FOREVER_NS: none so far."""
        at = int(np.searchsorted(self._stamps_ns, t_ns))
        return int(self._stamps_ns[at]) if at < len(self._stamps_ns) else FOREVER_NS


class ByTime:
    """Samples that hold the time of day, on the clock that the TIME object gives.

    A line under the arrivals of TIME gives its clock. A time of day is cut off at its step, so half
    of it is added.

    Parameters
    ----------
    step_s : unit of a sample's time, which counts from midnight
    period_s : nominal period of the samples
    tolerance_ppm : bound of the clock's rate error
    wire_ns : time on the wire of TIME
    latest_s : an older sample has no time
    """

    def __init__(
        self, step_s: float, period_s: float, tolerance_ppm: float, wire_ns: float, latest_s: float
    ) -> None:
        self._step_ms, self._period_ms = step_s * 1e3, period_s * 1e3
        self._latest_ms, self._wire_ns = latest_s * 1e3, wire_ns
        self._clock = ClockModel(TICK_S, tolerance_ppm)
        self._waiting: deque[tuple[int, int]] = deque()  # stamp [ns] and value [ms] of TIME
        self._told_ns = 0
        self._newest, self._newest_ms = -1, -np.inf

    def note(self, told: Sequence[tuple[int, int]]) -> None:
        """Accept stamps [ns] and values [ms since 1984] of TIME in a batch."""
        self._waiting += told

    def stamps(self, t_ns: IntArray, device: FloatArray) -> tuple[IntArray, IntArray]:
        """Accept the next samples; return numbers and times of validity."""
        pairs = zip(t_ns.tolist(), device.tolist(), strict=True)
        found = [self._stamp(*pair) for pair in pairs]
        number, times_ns = np.array(found, np.int64).reshape(-1, 2).T
        return number, times_ns

    def _stamp(self, t_ns: int, device: float) -> tuple[int, int]:
        while self._waiting and self._waiting[0][0] <= t_ns:
            self._told_ns, value = self._waiting.popleft()
            self._clock.observe(value, self._told_ns, -self._wire_ns)
        if not self._clock.ready or t_ns - self._told_ns > OLD_NS or np.isnan(device):
            return REFUSED, t_ns
        now_ms = self._clock.device_time(t_ns)
        own_ms = (device + 0.5) * self._step_ms
        ahead_ms = (own_ms - now_ms + DAY_MS / 2) % DAY_MS - DAY_MS / 2
        own_ms = now_ms + ahead_ms
        if not -self._latest_ms <= ahead_ms <= self._step_ms or own_ms <= self._newest_ms:
            return REFUSED, t_ns
        steps = (own_ms - self._newest_ms) / self._period_ms if self._newest >= 0 else 1
        self._newest, self._newest_ms = self._newest + max(1, round(steps)), own_ms
        return self._newest, t_ns + round(ahead_ms * (1e6 + self._clock.rate_error_ppm))


def time_objects(frames: FrameArray) -> list[tuple[int, int]]:
    """Return stamp [ns] and value [ms since 1984] of TIME frames; shorter ones are left out."""
    own = frames[frames["length"] >= TIME_BYTES]
    data = np.ascontiguousarray(own["data"][:, :TIME_BYTES])
    ms = data[:, :4].copy().view("<u4")[:, 0].astype(np.int64) & 0x0FFFFFFF
    days = data[:, 4:].copy().view("<u2")[:, 0].astype(np.int64)
    return list(zip(own["t_ns"].tolist(), (days * DAY_MS + ms).tolist(), strict=True))
