"""Whether the stamps of SYNC creep: against the answers to them, and against our own clock.

A sample takes its time from the stamp of a SYNC. The nodes answer after a delay that they and the
bus fix, and one clock stamps both. So stamps that creep change the delay, whoever sends SYNC, by
whatever crystal. Where the daemon sends SYNC, on a grid of its own clock, stamps of that clock also
keep their place within the period. This is judged once they have kept it for a while: a log that
another computer has stamped does not.

On a busy machine delays and places scatter, step and walk, up as often as down; their changes from
one bin to the next differ. In a creep they are alike. Student's t of their mean tells the two
apart, at a stated rate for a walk, the worst of the honest ones. A frame of a second, free-running
sender may slide through the answers and move them by its own length, so a creep must be longer.
"""

from collections import deque

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from fsw.messages import FloatArray, IntArray
from fsw.messages.false_alarms import per_test

BIN_S, BIN_SYNCS = 0.05, 10  # a bin is as long as the longer of the two
STEPS = 16  # changes from bin to bin that are compared
SPANS = (1, 2, 4, 8, 16, 32)  # lengths of the compared bins; a bin's mean is used
WALK_SHARE = 1.5  # variance of a walk's change over all bins / that of independent steps
FRAME_BITS = 160  # longest classic frame, with stuff bits and the gap behind it
FRAMES = 1.5  # a frame of another sender moves the delay by less
BITRATE = 1_000_000  # of a bus whose configuration leaves it to the system
KEPT_SPAN = 8  # length of the bins over which a place must first be kept: 6.8 s at 500 Hz
KEPT = 0.25  # of the limit: 9e-6 of that time, less than most crystals differ
EARLY = 0.1  # share of the stamps that are prompt on a busy machine too
BEFORE = 0.25  # of a period in which a stamp counts as early and not as very late
MOST_TURNS = 8  # even, so that their parity stays


class SyncPace:
    """The delay of the answers to SYNC, and the place of SYNC within our own period, bin by bin.

    Nothing depends on where a batch ends.
    """

    def __init__(self, rate_hz: float, bitrate: int | None = None, *, own: bool = False) -> None:
        """`own`: the daemon sends SYNC itself."""
        self._bin_syncs = max(BIN_SYNCS, round(BIN_S * rate_hz))
        self._period_ns = 1e9 / rate_hz
        limit_ns = FRAMES * FRAME_BITS * 1e9 / (bitrate or BITRATE)
        self._delay = _Course(limit_ns)
        self._place = _Course(limit_ns, self._period_ns) if own else None
        self._bin, self._sync = 0, -1  # the present bin, and the SYNC that was answered last
        self._answered: list[IntArray] = []  # of the present bin: stamps of SYNC and first answer
        self._first_ns: int | None = None
        self._place_ns = 0.0
        self._turns: list[int] = []  # SYNCs from which on stamps creep, are in pace, ...

    @property
    def moved_ns(self) -> float:
        """Movement of the stamps since they were last in pace."""
        delay, place = self._delay, self._place
        return place.moved_ns if place is not None and place.is_out else -delay.moved_ns

    def crept(self, syncs: IntArray) -> NDArray[np.bool_]:
        """Return whether the stamp of each SYNC, by running index (k,), has crept."""
        return np.asarray(np.searchsorted(self._turns, syncs, side="right") % 2 == 1)

    def follow(self, syncs: IntArray, newest: IntArray, sync_ns: IntArray, t_ns: IntArray) -> None:
        """Accept answers in order of arrival; all arrays (k,).

        Parameters
        ----------
        syncs : running index of the answered SYNC
        newest : running index of the newest SYNC before the answer; it never decreases
        sync_ns, t_ns : stamps of the answered SYNC and of the answer
        """
        if not len(syncs):
            return
        is_first = np.diff(syncs, prepend=self._sync) != 0
        self._sync = int(syncs[-1])
        bins = newest[is_first] // self._bin_syncs
        starts = np.flatnonzero(np.diff(bins, prepend=self._bin))
        parts = np.split(np.stack([sync_ns[is_first], t_ns[is_first]]), starts, axis=1)
        self._answered.append(parts[0])
        for part, number in zip(parts[1:], bins[starts].tolist(), strict=True):
            self._close(number * self._bin_syncs)
            self._bin, self._answered = number, [part]

    def _close(self, next_sync: int) -> None:
        """Judge the bin before a SYNC."""
        sync_ns, t_ns = np.concatenate(self._answered, axis=1).astype(np.int64)
        if not len(t_ns):
            return
        self._delay.add(float(np.median(t_ns - sync_ns)))
        if self._place is not None:
            self._place.add(self._place_of(sync_ns))
        is_out = self._delay.is_out or (self._place is not None and self._place.is_out)
        if is_out != bool(len(self._turns) % 2):
            self._turns = [*self._turns[-MOST_TURNS:], next_sync]

    def _place_of(self, sync_ns: IntArray) -> float:
        """Return the place of the early stamps of a bin within their period, unwrapped [ns]."""
        if self._first_ns is None:
            self._first_ns = int(sync_ns[0])
        period_ns, since_ns = self._period_ns, sync_ns - self._first_ns - self._place_ns
        behind_ns = (since_ns + BEFORE * period_ns) % period_ns - BEFORE * period_ns
        self._place_ns += float(np.quantile(behind_ns, EARLY))
        return self._place_ns


class _Course:
    """A quantity bin by bin, and whether it has crept away from where it was.

    Attributes
    ----------
    is_out : it has crept by more than the limit and is not back within half of that
    moved_ns : its movement since then
    """

    def __init__(self, limit_ns: float, period_ns: float | None = None) -> None:
        """`period_ns` of a place, which is judged once it has been constant; None: no place."""
        self._limit_ns, self._period_ns = limit_ns, period_ns
        self._is_kept = period_ns is None
        self._levels: deque[float] = deque(maxlen=(STEPS + 1) * SPANS[-1])
        self._count = 0
        self.is_out, self.moved_ns = False, 0.0

    def add(self, level_ns: float) -> None:
        """Accept the level of the next bin."""
        step_ns = level_ns - self._levels[-1] if self._levels else 0.0
        self._levels.append(level_ns)
        self._count += 1
        if not self.is_out:
            self._judge()
            return
        self.moved_ns += step_ns
        period_ns = self._period_ns
        if period_ns is not None and abs(step_ns) > self._limit_ns:  # or by whole periods
            self.moved_ns = (self.moved_ns + 0.5 * period_ns) % period_ns - 0.5 * period_ns
        if abs(self.moved_ns) <= 0.5 * self._limit_ns:
            self.is_out = False
            self._levels.clear()

    def _judge(self) -> None:
        """Compare the newest bins of each span."""
        for span in SPANS:
            length = (STEPS + 1) * span
            if self._count % span or len(self._levels) < length:
                return
            means = np.array(self._levels)[-length:].reshape(-1, span).mean(axis=1)
            if span == KEPT_SPAN and np.ptp(means) <= KEPT * self._limit_ns:
                self._is_kept = True
            moved_ns = float(means[-1] - means[0])
            if self._is_kept and abs(moved_ns) > self._limit_ns and steadiness(means) > STEADY:
                self.is_out, self.moved_ns = True, self._levels[-1] - float(means[0])
                return


def steadiness(means: FloatArray) -> float:
    """Return |Student's t| of the mean change between adjacent means (k,) of bins.

    Changes between the means of a walk are correlated, for which t is lowered.
    """
    steps = np.diff(means)
    scatter = float(steps.std(ddof=1)) * (WALK_SHARE / len(steps)) ** 0.5
    return abs(float(steps.mean())) / scatter if scatter else np.inf


STEADY = float(stdtrit(STEPS - 1, 1.0 - 0.5 * per_test("pace")))
