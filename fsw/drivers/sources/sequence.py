"""Unwrap a device counter with the help of host time, and reject impossible counters.

A datagram cannot arrive before it was measured, so a counter ahead of host time is wrong; so is a
repeated counter. Host time also shows how often the counter wrapped in a silence. A unit that
restarted sends a series of wrong counters; after 0.1 s in unbroken order they are believed.

The unit reports how long a datagram waited before it was sent (latency). A longer wait must delay
the datagram by as much. A wait that puts the sample ahead of the clock model instead is untrue.
"""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from fsw.drivers.sources.clock_model import ClockModel
from fsw.messages import FloatArray, IntArray

CHAIN_S = 0.1  # rejects in unbroken order for this long are believed to be the unit's new time
EARLY_RATIO = 0.4  # of a sample period: a sample earlier than the model by more is impossible
LATE_S = 0.02  # the first datagram after a silence may be later than the model by this
WRAP_RATIO = 0.9  # of the counter's period: a longer silence may hide a wrap
STEP_TOLERANCE = 0.1
UNTRUE_RATIO = 0.1  # of a sample period: a smaller growth of the wait is not judged


class Step(Enum):
    """Verdict on a counter: only NEXT and RESTART may be accepted."""

    NEXT = "next"
    RESTART = "restart"  # believed, but the clock model must restart
    WRONG = "wrong"
    UNTRUE = "untrue"  # the counter may be right, the latency is not


@dataclass(frozen=True, slots=True)
class Counted:
    """A counter with the times of its datagram."""

    counter: int
    t_ns: int  # stamp of the chunk with the datagram's last byte
    sent_ns: float  # t_ns minus latency and serialisation time
    queued: int  # datagrams of the same chunk from this one on
    latency_ns: float = 0.0  # as the unit reports it


class CounterTrack:
    """Counter of one unit, unwrapped to an index on the unit's own clock.

    Parameters
    ----------
    modulus : the counter wraps here
    tick_s : nominal length of a count [s]
    step : nominal counts per sample
    """

    def __init__(self, modulus: int, tick_s: float, step: float) -> None:
        self._modulus = modulus
        self._tick_ns = tick_s * 1e9
        self._step = step
        self._wrap_ns = WRAP_RATIO * modulus * self._tick_ns
        self._chain_limit = max(3, round(CHAIN_S / (tick_s * step)))
        self._started = False
        self._counter = 0
        self._t_ns = 0
        self._latency_ns = 0.0
        self._chain = 0
        self._chain_counter = 0
        self.index = 0  # index of the last accepted sample [ticks]
        self.interval = step  # ticks since the sample before if that one was received
        self.lost = 0

    def is_repeated(self, counter: int) -> bool:
        """Return whether this is the counter of the last accepted sample."""
        return self._started and counter == self._counter

    def check(self, item: Counted, clock: ClockModel) -> Step:
        """Judge a counter without accepting it; call `accept` after NEXT or RESTART."""
        if not self._started:
            return Step.NEXT
        ahead = (item.counter - self._counter) % self._modulus
        if self._is_unbroken(item):
            if ahead == 0:
                return Step.WRONG
            good = self._is_step(ahead) or (
                self._is_multiple(ahead)
                and not self._is_early(self.index + ahead, item.sent_ns, clock)
            )
            index = self.index + ahead
        else:
            good = clock.ready and self._is_punctual(item, clock)
            index = self._after_silence(item, clock) if good else 0
        if good and self._is_untrue(index, item, clock):
            return self._doubt(item.counter, Step.UNTRUE)
        return Step.NEXT if good else self._doubt(item.counter, Step.WRONG)

    def follow(self, counters: IntArray, t_ns: IntArray, latency_ns: FloatArray) -> IntArray | None:
        """Accept counters (k,) that follow one another step by step; return their indexes (k,).

        Return None and accept none when `check` must judge: after a gap, a silence, a repeated
        counter or a longer wait.
        """
        if not self._started:
            return None
        ahead = np.diff(counters, prepend=self._counter) % self._modulus
        waited_ns = np.diff(t_ns, prepend=self._t_ns)
        longer_ns = np.diff(latency_ns, prepend=self._latency_ns)
        regular = np.abs(ahead - self._step) <= STEP_TOLERANCE * self._step
        regular &= waited_ns < self._wrap_ns
        regular &= longer_ns <= UNTRUE_RATIO * self._step * self._tick_ns
        if np.count_nonzero(regular) < len(counters):
            return None
        indexes = self.index + np.cumsum(ahead)
        self.index, self._counter = int(indexes[-1]), int(counters[-1])
        self._t_ns, self._latency_ns, self._chain = int(t_ns[-1]), float(latency_ns[-1]), 0
        return indexes

    def accept(self, item: Counted, clock: ClockModel, step: Step) -> int:
        """Accept a counter that `check` judged NEXT or RESTART; return its index [ticks]."""
        if not self._started:
            self.index = item.counter
        else:
            if step is Step.RESTART:
                silence = (item.t_ns - self._t_ns) / (self._step * self._tick_ns)
                index = self.index + round(max(1, round(silence)) * self._step)
            elif self._is_unbroken(item):
                index = self.index + (item.counter - self._counter) % self._modulus
            else:
                index = self._after_silence(item, clock)
            ahead = index - self.index
            self.interval = ahead if self._is_step(ahead) else self._step
            self.lost += max(0, round(ahead / self._step) - 1)
            self.index = index
        self._started = True
        self._counter, self._t_ns, self._chain = item.counter, item.t_ns, 0
        self._latency_ns = item.latency_ns
        return self.index

    def _is_unbroken(self, item: Counted) -> bool:
        """Return whether the silence before the datagram is too short to hide a wrap."""
        explained_ns = item.queued * self._step * self._tick_ns
        return item.t_ns - self._t_ns - explained_ns < self._wrap_ns

    def _after_silence(self, item: Counted, clock: ClockModel) -> int:
        ahead = (item.counter - self._counter) % self._modulus
        now = clock.device_time(item.sent_ns) - (item.queued - 1) * self._step
        wraps = int((now - self.index - ahead) / self._modulus + (1 - WRAP_RATIO))
        return self.index + ahead + max(wraps, 0 if ahead else 1) * self._modulus

    def _is_punctual(self, item: Counted, clock: ClockModel) -> bool:
        index = self._after_silence(item, clock)
        late_ns = -clock.early_ns(index, item.sent_ns)
        allowed_ns = LATE_S * 1e9 + (item.queued - 1) * self._step * self._tick_ns
        return (
            self._is_multiple(index - self.index)
            and not self._is_early(index, item.sent_ns, clock)
            and late_ns <= allowed_ns
        )

    def _is_step(self, ahead: int) -> bool:
        return abs(ahead - self._step) <= STEP_TOLERANCE * self._step

    def _is_multiple(self, ahead: int) -> bool:
        return abs(ahead / self._step - round(ahead / self._step)) <= STEP_TOLERANCE

    def _is_early(self, index: int, sent_ns: float, clock: ClockModel) -> bool:
        limit_ns = EARLY_RATIO * self._step * self._tick_ns
        return clock.ready and clock.early_ns(index, sent_ns) > limit_ns

    def _is_untrue(self, index: int, item: Counted, clock: ClockModel) -> bool:
        """Return whether a longer wait than the last one puts the sample ahead of the clock."""
        longer_ns = item.latency_ns - self._latency_ns
        limit_ns = UNTRUE_RATIO * self._step * self._tick_ns
        if longer_ns <= limit_ns or not clock.ready:
            return False
        return clock.early_ns(index, item.sent_ns) > max(limit_ns, 0.5 * longer_ns)

    def _doubt(self, counter: int, step: Step) -> Step:
        in_order = self._chain and self._is_step((counter - self._chain_counter) % self._modulus)
        self._chain = self._chain + 1 if in_order else 1
        self._chain_counter = counter
        return Step.RESTART if self._chain >= self._chain_limit else step
