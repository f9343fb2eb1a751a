"""Samples of devices whose frames a description gives: put together and timed, not judged."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.config import BusConfig
from fsw.config.signals import BY_SYNC, TimingConfig
from fsw.drivers.codecs.canopen import COB_SYNC
from fsw.drivers.layout.joints import COUNTER, STATUS, TIME, Layout
from fsw.drivers.sources.cues import COB_TIME, TIME_BITS, ByTime, Cues, time_objects
from fsw.drivers.sources.described_frames import FrameReader
from fsw.drivers.sources.groups import Group, Groupings
from fsw.drivers.sources.replies import Replies
from fsw.drivers.sources.sync import UNKNOWN, SyncHistory, history_of
from fsw.drivers.sources.validity import (
    ASSUMED_BITRATE,
    ByArrival,
    ByDeviceTime,
    Validity,
    wire_s,
)
from fsw.drivers.wire import EFF_FLAG, SFF_MASK, FrameArray
from fsw.messages import FloatArray, IntArray

LATEST_RATIO = 0.9  # of a period: a sample later after its cue is refused
BY_CUE = ("last_sync", "request")
EACH = 1.5  # cues per period: a device with fewer answers each of them
SPREAD_RATIO = 0.5  # of a period between the frames of one sample
LATEST_S = 1.0  # age of a sample by the time of day that it holds


class Timed(NamedTuple):
    """Samples of all devices, sorted by device; all arrays (k,), `values` (k, roles)."""

    device: IntArray  # place in the list of devices
    number: IntArray  # running, UNKNOWN if the sample has no time
    t_ns: IntArray  # time of validity
    done_ns: IntArray  # when the last frame had come and its cue was known
    values: FloatArray
    status: IntArray
    is_good: NDArray[np.bool_]  # by the status
    crept: NDArray[np.bool_]  # without a time, because the stamps of SYNC creep


class DescribedSamples:
    """Reads the frames of described devices of one bus.

    Parameters
    ----------
    rates_hz : nominal rate of each device's samples
    """

    def __init__(
        self, bus: BusConfig, layouts: Sequence[Layout], rates_hz: Sequence[float]
    ) -> None:
        self._count = len(layouts)
        self._reader = FrameReader(layouts)
        timings = [layout.timing for layout in layouts]
        own = list(zip(timings, layouts, [1.0 / rate for rate in rates_hz], strict=True))
        self._late_ns = np.array([round(timing.delay_s * 1e9) for timing in timings])
        self._late_ns -= round(bus.latch_offset_s * 1e9) * np.isin(
            [timing.by for timing in timings], [*BY_SYNC, "request"]
        )
        self._echoes = np.array([timing.by == "echoed_counter" for timing in timings])
        self._sync_cues = Cues([COB_SYNC])
        self._cues = {timing.requests: Cues(_words(timing)) for timing in timings}
        self._cues |= {(): self._sync_cues}
        self._validity = [
            _validity_of(bus, timing, layout, period_s) for timing, layout, period_s in own
        ]
        latest_s = [timing.latest_s or LATEST_RATIO * period_s for timing, _, period_s in own]
        self._latest_ns = np.round(np.array(latest_s) * 1e9).astype(np.int64)
        kinds = [timing.requests if timing.by in BY_CUE else None for timing in timings]
        each = [
            kind is not None and period_s * bus.rate_hz < EACH
            for kind, (_, _, period_s) in zip(kinds, own, strict=True)
        ]
        members = [len(layout.parts) for layout in layouts]
        self._replies = [
            Replies(
                cues,
                np.array([kind == requests for kind in kinds]),
                np.array(each),
                max(members),
            )
            for requests, cues in self._cues.items()
            if requests in kinds
        ]
        spreads_ns = [
            None if is_each else round((timing.spread_s or SPREAD_RATIO * period_s) * 1e9)
            for is_each, (timing, _, period_s) in zip(each, own, strict=True)
        ]
        self._groups = Groupings(list(zip(members, spreads_ns, strict=True)))
        self._by_time = [own for own in self._validity if isinstance(own, ByTime)]
        self._mask = np.array([layout.mask for layout in layouts])
        self._wanted = np.array([layout.value for layout in layouts])
        self._syncs: SyncHistory = history_of(bus)
        self.heard_ns: list[int | None] = [None] * len(layouts)  # newest frame of each device
        self.words = self._reader.words  # identifiers of the devices' frames, with flag bits

    @property
    def sync_count(self) -> int:
        """Number of SYNCs."""
        return self._sync_cues.count

    @property
    def movement(self) -> str:
        """How far the stamps of SYNC have crept, in words."""
        return self._syncs.movement

    @property
    def headless(self) -> int:
        """Number of samples without the message that carries the time."""
        return self._groups.headless

    def others(self, frames: FrameArray) -> int:
        """Return the number of frames that are neither a device's nor a cue."""
        known = [self.words, *(cues.words for cues in self._cues.values())]
        return int(np.count_nonzero(~np.isin(frames["word"], np.concatenate(known))))

    def read(self, frames: FrameArray) -> tuple[Timed, list[tuple[int, int, int]]]:
        """Accept frames in order, sent ones included.

        Returns
        -------
        The samples; and for each frame of a wrong length its device, stamp [ns] and size [bytes].
        """
        words = np.ascontiguousarray(frames["word"])
        for cues in self._cues.values():
            is_cue = words == cues.words[0] if len(cues.words) == 1 else np.isin(words, cues.words)
            cues.note(frames["t_ns"][is_cue].astype(np.int64))
        if self._by_time and (is_time := words == COB_TIME).any():
            told = time_objects(frames[is_time])
            for by_time in self._by_time:
                by_time.note(told)
        if self._echoes.any():
            self._syncs.note(frames)
        device, arrivals, short = self._reader.read(frames, words)
        ends = np.flatnonzero(np.diff(device, append=self._count))
        for place, t_ns in zip(device[ends].tolist(), arrivals.t_ns[ends].tolist(), strict=True):
            self.heard_ns[place] = t_ns
        for replies in self._replies:
            device, arrivals = replies.date(device, arrivals)
        device, group = self._groups.feed(device, arrivals)
        index, times_ns, crept = self._times(device, group)
        raw = group.values[:, STATUS]
        status = _whole(raw)
        is_good = status & self._mask[device] == self._wanted[device]
        is_good &= ~np.isnan(raw) | (self._mask[device] == 0)
        timed = Timed(device, index, times_ns, group.done_ns, group.values, status, is_good, crept)
        return timed, short

    def _times(
        self, device: IntArray, group: Group
    ) -> tuple[IntArray, IntArray, NDArray[np.bool_]]:
        """Return running index, UNKNOWN if it has no time, time, and whether its SYNC has crept."""
        sent_ns, sent_row, values, _, index, t_ns = group
        index = np.where(sent_ns - t_ns > self._latest_ns[device], UNKNOWN, index)
        crept = np.zeros(len(device), np.bool_)
        if self._echoes.any():  # without samples too: rows of SYNCs are those of this batch
            own = self._echoes[device]
            counters = _whole(values[own, COUNTER])
            rows = np.maximum(sent_row[own], 0)
            order = np.argsort(rows, kind="stable")
            places = np.flatnonzero(own)[order]
            matched = self._syncs.match(counters[order], rows[order], sent_ns[places])
            index[places] = np.where(matched.crept, UNKNOWN, matched.sync)
            t_ns[places], crept[places] = matched.stamp_ns, matched.crept
        bounds = np.searchsorted(device, np.arange(self._count + 1)).tolist()
        for validity, start, stop in zip(self._validity, bounds[:-1], bounds[1:], strict=True):
            if validity is not None and stop > start:
                found = validity.stamps(sent_ns[start:stop], values[start:stop, TIME])
                index[start:stop], t_ns[start:stop] = found
        return index, t_ns - self._late_ns[device], crept


def _whole(values: FloatArray) -> IntArray:
    """Return whole numbers as such; 0 for NaN."""
    return np.where(np.isnan(values), 0.0, values).astype(np.int64)


def _words(timing: TimingConfig) -> list[int]:
    """Return the identifiers of requests with flag bits."""
    return [own | EFF_FLAG * (own > SFF_MASK) for own in timing.requests]


def _validity_of(
    bus: BusConfig, timing: TimingConfig, layout: Layout, period_s: float
) -> Validity | None:
    """Return what gives a device's samples their times; None: a cue."""
    ppm, wire_ns = timing.clock_tolerance_ppm, wire_s(layout.messages[0], bus) * 1e9
    if timing.by == "arrival":
        return ByArrival(period_s, ppm, wire_ns)
    time = layout.use(TIME)
    if timing.by == "device_time" and time is not None:
        return ByDeviceTime(1 << time.signal.bits, time.factor, period_s, ppm, wire_ns)
    if timing.by == "time" and time is not None:
        told_ns = 1e9 * TIME_BITS / (bus.bitrate or ASSUMED_BITRATE)
        return ByTime(time.factor, period_s, ppm, told_ns, timing.latest_s or LATEST_S)
    return None
