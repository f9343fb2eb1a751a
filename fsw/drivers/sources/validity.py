"""Times of validity of frames that echo no counter of SYNC: by arrival, and by device time.

Both fit a line under all arrivals (`clock_model`), each device's own. Without a counter the samples
are counted by that line and the nominal period: an arrival may be late by most of a period and
never early. If all arrivals of a second are late, the device's timer has changed its phase.
"""

from collections.abc import Sequence
from math import floor, inf, nan
from typing import NamedTuple, Protocol

import numpy as np

from fsw.config import BusConfig
from fsw.drivers.layout.signals import Message
from fsw.drivers.sources.clock_model import ClockModel
from fsw.drivers.sources.sequence import Counted, CounterTrack, Step
from fsw.messages import FloatArray, IntArray

SETTLED = 50  # samples after which an arrival before the line is impossible
EARLY_RATIO = 0.1  # of a period: the line's error explains an arrival that much before it
LATE_RATIO = 0.25  # of a period: if SETTLED arrivals in a row are later, the phase has changed
NEAR_RATIO = 0.05  # of a period: an arrival so much before the line is surely the next one
DOUBTED = 3  # impossible arrivals in a row after which the line begins anew
REFUSED = -1
ASSUMED_BITRATE = 1_000_000


class Stamp(NamedTuple):
    """A sample's running number, REFUSED if it has no time, and its time of validity."""

    number: int
    t_ns: int


class Validity(Protocol):
    """Gives the samples of one device their times."""

    def stamps(self, t_ns: IntArray, device: FloatArray) -> tuple[IntArray, IntArray]:
        """Accept the next samples; return numbers and times of validity (k,).

        Parameters
        ----------
        t_ns, device : (k,) stamps of their frames [ns], device times on the wire [ticks]
        """
        ...


class ByArrival:
    """Samples of a device that sends by a timer of its own, without any time.

    Parameters
    ----------
    period_s : nominal period of the timer
    tolerance_ppm : bound of the timer's rate error
    wire_ns : time on the wire of a frame
    """

    def __init__(self, period_s: float, tolerance_ppm: float, wire_ns: float) -> None:
        self._clock = ClockModel(period_s, tolerance_ppm)
        self._period_ns, self._wire_ns = period_s * 1e9, wire_ns
        self._newest = -1
        self._begin()

    def _begin(self) -> None:
        self._clock.reset()
        self._accepted = self._doubted = 0
        self._least_ns, self._watched = inf, 0

    def stamp(self, t_ns: int, device: float) -> Stamp:  # noqa: ARG002
        """Accept the next sample; `device` has no use."""
        clock = self._clock
        index = self._newest + 1
        if clock.ready:
            early = EARLY_RATIO if self._accepted > SETTLED else 0.5
            index = floor(clock.device_time(t_ns - self._wire_ns) + early)
            if index <= self._newest:
                self._doubted += 1
                if self._doubted < DOUBTED:
                    return Stamp(REFUSED, 0)
                self._begin()
                index = self._newest + 1
        clock.observe(index, t_ns, -self._wire_ns)
        self._newest = index
        self._accepted, self._doubted = self._accepted + 1, 0
        reference_ns, rest_ns = clock.predict_ns(index)
        self._watch(t_ns - self._wire_ns - reference_ns - rest_ns)
        return Stamp(index, reference_ns + round(rest_ns))

    def stamps(self, t_ns: IntArray, device: FloatArray) -> tuple[IntArray, IntArray]:
        """Accept the next samples; return numbers and times of validity.

        Arrivals so near the line that each can only be that of the next sample are recorded in one
        loop, with the same result.
        """
        del device
        left, numbers, times_ns = t_ns.tolist(), list[int](), list[int]()
        while left:
            rests_ns = self._near(left) if self._accepted > SETTLED else []
            if rests_ns:
                reference_ns = self._clock.reference_ns
                numbers += range(self._newest + 1 - len(rests_ns), self._newest + 1)
                times_ns += [reference_ns + round(rest_ns) for rest_ns in rests_ns]
                left = left[len(rests_ns) :]
            if left:
                number, time_ns = self.stamp(left.pop(0), nan)
                numbers.append(number)
                times_ns.append(time_ns)
        return np.array(numbers, np.int64), np.array(times_ns, np.int64)

    def _near(self, t_ns: Sequence[int]) -> list[float]:
        """Record the first arrivals that are near the line; return the model's times of them."""
        early_ns, late_ns = (ratio * self._period_ns for ratio in (NEAR_RATIO, LATE_RATIO))
        first = self._newest + 1
        found = self._clock.follow_near(first, t_ns, -self._wire_ns, early_ns, late_ns)
        if count := len(found):
            self._newest += count
            self._accepted, self._doubted = self._accepted + count, 0
            self._watched = (self._watched + count) % SETTLED
            self._least_ns = 0.0 if self._watched else inf  # one of them was not late
        return found

    def _watch(self, late_ns: float) -> None:
        """Begin again if every one of SETTLED arrivals was late; the next sample is the first."""
        self._least_ns = min(self._least_ns, late_ns)
        self._watched += 1
        if self._watched == SETTLED:
            is_late = self._least_ns > LATE_RATIO * self._period_ns
            self._least_ns, self._watched = inf, 0
            if is_late:
                self._begin()


class ByDeviceTime:
    """Samples that hold the time of the device's own clock, which may wrap.

    Parameters
    ----------
    modulus, tick_s : where the device's time wraps, and its nominal unit
    period_s : nominal period of the samples
    tolerance_ppm : bound of the clock's rate error
    wire_ns : time on the wire of a frame
    """

    def __init__(
        self, modulus: int, tick_s: float, period_s: float, tolerance_ppm: float, wire_ns: float
    ) -> None:
        self._clock = ClockModel(tick_s, tolerance_ppm)
        self._step = period_s / tick_s
        self._track = CounterTrack(modulus, tick_s, self._step)
        self._wire_ns = wire_ns
        self._newest, self._ticks = -1, 0

    def stamps(self, t_ns: IntArray, device: FloatArray) -> tuple[IntArray, IntArray]:
        """Accept the next samples; return numbers and times of validity."""
        pairs = zip(t_ns.tolist(), device.tolist(), strict=True)
        found = [self.stamp(*pair) for pair in pairs]
        number, times_ns = np.array(found, np.int64).reshape(-1, 2).T
        return number, times_ns

    def stamp(self, t_ns: int, device: float) -> Stamp:
        """Accept the next sample."""
        if device != device:  # noqa: PLR0124  # not in the sample
            return Stamp(REFUSED, 0)
        counted = Counted(int(device), t_ns, t_ns - self._wire_ns, 1)
        step = self._track.check(counted, self._clock)
        if step in (Step.WRONG, Step.UNTRUE):
            return Stamp(REFUSED, 0)
        if step is Step.RESTART:
            self._clock.reset()
        ticks = self._track.accept(counted, self._clock, step)
        self._clock.observe(ticks, t_ns, -self._wire_ns)
        self._newest += (
            max(1, round((ticks - self._ticks) / self._step)) if self._newest >= 0 else 1
        )
        self._ticks = ticks
        reference_ns, rest_ns = self._clock.predict_ns(ticks)
        return Stamp(self._newest, reference_ns + round(rest_ns))


def wire_s(message: Message, bus: BusConfig) -> float:
    """Return the least time of a message on the wire, without stuff bits [s].

    Source of the numbers of bits: ISO 11898-1:2015. A bus for CAN FD has frames of that form.
    """
    bitrate, data_bits = bus.bitrate or ASSUMED_BITRATE, 8 * message.length
    if not bus.fd:
        return ((67 if message.is_extended else 47) + data_bits) / bitrate
    crc_bits = (17 + 6) if message.length <= 16 else (21 + 7)  # with fixed stuff bits
    fast_bits = 5 + data_bits + 4 + crc_bits  # ESI, DLC; stuff count
    slow_bits = 49 if message.is_extended else 30
    return slow_bits / bitrate + fast_bits / (bus.data_bitrate or bitrate)
