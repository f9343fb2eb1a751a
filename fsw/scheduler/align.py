"""Sorting of samples into windows: all channels over one interval, with missing and stale marks.

Window k holds the samples valid in [t0 + k T, t0 + (k + 1) T) and closes at its end plus the lag.
The stamps alone decide which samples a window holds, not the times at which the loop ran. A jump of
the clock leaves billions of empty windows; all but `MOST_EMPTY` of such a gap are skipped.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsw.config import Config
from fsw.messages import (
    ChannelWindow,
    DeviceSamples,
    FloatArray,
    ImuSamples,
    IntArray,
    JointSamples,
    Samples,
    Window,
    joined,
)

FRESHNESS_PERIODS = 5.0  # a channel silent for longer than this many sample periods is stale
SPARE_WINDOWS = 3  # a sample valid more than this many windows after its receipt is invalid
_ONLY = np.zeros(1, np.int64)  # channel index of a kind with one channel
MOST_EMPTY = 9000  # windows closed in a gap of any length: an hour of windows of 0.4 s
MAX_WAITING = 16384  # most samples that are not sorted in yet


@dataclass(frozen=True, slots=True)
class AlignCounters:
    """Numbers of samples left out of their windows."""

    late: dict[str, int]  # by source: received after the window had closed or after its deadline
    early: int  # valid before the first window
    future: int  # valid more than SPARE_WINDOWS after their receipt
    overflow: int  # found no room in their window


@dataclass(slots=True)
class _Channel:
    """Limits of one channel's samples in a window, and the time of its newest sample."""

    min_count: int
    max_count: int
    freshness_ns: int
    newest_ns: int | None = None

    def window(self, t_ns: IntArray, values: FloatArray, stop_ns: int) -> ChannelWindow:
        """Return a window of the channel from samples in order of arrival, sorted by time."""
        if (t_ns[1:] < t_ns[:-1]).any():
            order = np.argsort(t_ns, kind="stable")
            t_ns, values = t_ns[order], values[order]
        if t_ns.size:
            self.newest_ns = max(int(t_ns[-1]), self.newest_ns or int(t_ns[-1]))
        t_ns.setflags(write=False)
        values.setflags(write=False)
        stale = self.newest_ns is None or stop_ns - self.newest_ns > self.freshness_ns
        return ChannelWindow(
            t_ns=t_ns, values=values, missing=t_ns.size < self.min_count, stale=stale
        )


class _Bins:
    """Samples of all channels of one kind in the open windows, in order of arrival."""

    def __init__(self, width: int, channels: Sequence[_Channel]) -> None:
        self._width = width
        self._channels = tuple(channels)
        self._max_counts = np.array([channel.max_count for channel in channels])
        self._parts: dict[int, list[tuple[IntArray, IntArray, FloatArray]]] = {}
        self._counts: dict[int, IntArray] = {}  # number of samples of each channel, by window

    def add(self, index: int, channel: IntArray, t_ns: IntArray, values: FloatArray) -> int:
        """Put samples in a window; return how many found no room."""
        held = self._counts.get(index)
        if held is None:
            held = np.zeros(len(self._channels), np.int64)
            self._parts[index] = []
        counts = held + np.bincount(channel, minlength=len(self._channels))
        excess = counts - self._max_counts
        if excess.max() <= 0:
            self._counts[index] = counts
            self._parts[index].append((channel, t_ns, values))
            return 0
        for k in np.flatnonzero(excess > 0).tolist():
            last = np.flatnonzero(channel == k)[-int(excess[k]) :]
            channel, t_ns = np.delete(channel, last), np.delete(t_ns, last)
            values = np.delete(values, last, axis=0)
        self._counts[index] = np.minimum(counts, self._max_counts)
        self._parts[index].append((channel, t_ns, values))
        return int(np.maximum(excess, 0).sum())

    def first(self) -> int | None:
        """Return the index of the first window that holds samples; None if none does."""
        return min(self._parts, default=None)

    def close(self, index: int, stop_ns: int) -> tuple[ChannelWindow, ...]:
        """Close a window and return its samples of every channel."""
        self._counts.pop(index, None)
        parts = self._parts.pop(index, None)
        if parts is None:
            owner, t_ns = np.empty(0, np.int64), np.empty(0, np.int64)
            values = np.empty((0, self._width))
        else:
            owner, t_ns, values = (np.concatenate(column) for column in zip(*parts, strict=True))
        order = np.argsort(owner, kind="stable")
        bounds = np.searchsorted(owner[order], np.arange(len(self._channels) + 1)).tolist()
        t_ns, values = t_ns[order], values[order]
        return tuple(
            channel.window(t_ns[start:stop], values[start:stop], stop_ns)
            for channel, start, stop in zip(self._channels, bounds[:-1], bounds[1:], strict=True)
        )


class Aligner:
    """Collects samples and returns closed windows, in order and without gaps.

    Samples are sorted in when a window closes, all of a kind at once. The window of a sample, and
    whether the sample is late, depend on its stamps alone.
    """

    def __init__(self, config: Config, n_joints: int) -> None:
        self._window_ns = round(config.estimator.window_s * 1e9)
        self._lag_ns = round(config.estimator.lag_s * 1e9)
        window_s, fill = config.estimator.window_s, config.estimator.min_fill_ratio

        def channel(rate_hz: float, *, one_is_enough: bool = False) -> _Channel:
            expected = rate_hz * window_s
            return _Channel(
                min_count=1 if one_is_enough else max(1, int(fill * expected)),
                max_count=int(4 * expected) + 16,
                freshness_ns=round(FRESHNESS_PERIODS / rate_hz * 1e9),
            )

        rates = {bus.name: bus.rate_hz for bus in config.buses}
        joints = [channel(rates[joint.bus]) for joint in config.joints[:n_joints]]
        self._joints = _Bins(2, joints)
        self._joint_names = [joint.name for joint in config.joints[:n_joints]]
        self._gyro = _Bins(3, [channel(config.imu.rate_hz)])
        self._acc = _Bins(3, [channel(config.imu.rate_hz)])
        self._devices = {}
        for section, own in config.devices.items():
            acts = section in config.actuators  # whose earlier samples show the state too
            channels = [channel(device.rate_hz, one_is_enough=acts) for device in own]
            self._devices[section] = _Bins(own[0].width, channels)
        tracker = config.star_tracker
        self._attitude = _Bins(4, [channel(tracker.rate_hz if tracker else 1.0)])
        self._t0_ns: int | None = None
        self._grid_ns: int | None = None  # start of window 0 of an earlier run that continues
        self._next = 0
        self._pushed: dict[object, list[Any]] = {}  # samples not sorted in yet, by kind
        self._pushed_count = 0
        self._late = dict.fromkeys([*self._joint_names, "imu", "star_tracker", *self._devices], 0)
        self._early = self._future = self._overflow = 0
        self.skipped = 0  # empty windows of gaps that were skipped

    @property
    def started(self) -> bool:
        """Whether t0 is known."""
        return self._t0_ns is not None

    def counters(self) -> AlignCounters:
        """Return the numbers of samples left out of their windows so far."""
        self._sort_in()
        return AlignCounters(dict(self._late), self._early, self._future, self._overflow)

    @property
    def next_index(self) -> int:
        """Index of the window that closes next."""
        return self._next

    def first_after(self, t_ns: int) -> int:
        """Return the index of the first window that begins at a time or later; 0 before start."""
        if self._t0_ns is None:
            return 0
        return max(self._next, -((self._t0_ns - t_ns) // self._window_ns))

    @property
    def deadline_ns(self) -> int | None:
        """Receive stamp after which the next window accepts no sample; None before the start."""
        return None if self._t0_ns is None else self._deadline(self._next)

    @property
    def grid_ns(self) -> int | None:
        """Start of window 0 [ns]; None before the start."""
        return self._t0_ns if self._t0_ns is not None else self._grid_ns

    def resume(self, grid_ns: int) -> None:
        """Continue the grid of windows of an earlier run, which began at `grid_ns` in the past."""
        self._grid_ns = grid_ns

    def start(self, first_ns: int) -> None:
        """Begin the grid of windows at the first SYNC; raise ValueError if it has begun.

        A resumed grid is kept; the next window is the first that begins at the SYNC or later.
        """
        if self._t0_ns is not None:
            raise ValueError(f"already started at {self._t0_ns} ns")
        self._t0_ns = first_ns
        if self._grid_ns is not None:
            self._t0_ns = self._grid_ns
            self._next = -((self._grid_ns - first_ns) // self._window_ns)

    def push(self, samples: Samples) -> None:
        """Accept samples; those that find no room before the start are counted as overflow."""
        if self._pushed_count >= MAX_WAITING:
            if self._t0_ns is None:
                self._overflow += len(samples)
                return
            self._sort_in()
        kind = samples.section if isinstance(samples, DeviceSamples) else type(samples)
        self._pushed.setdefault(kind, []).append(samples)
        self._pushed_count += len(samples)

    def _sort_in(self) -> None:
        """Sort the pushed samples into their windows."""
        if self._t0_ns is None:
            return
        pushed, self._pushed, self._pushed_count = self._pushed, {}, 0
        for parts in pushed.values():
            self._place(joined(parts))

    def _place(self, samples: Samples) -> None:
        received_ns = samples.t_receive_ns
        if isinstance(samples, JointSamples):
            values = np.column_stack([samples.position_rad, samples.torque_nm])
            late = self._add(self._joints, samples.joint, samples.t_ns, received_ns, values)
            for joint in samples.joint[late].tolist():
                self._late[self._joint_names[joint]] += 1
        elif isinstance(samples, ImuSamples):
            late = np.zeros(len(samples), np.bool_)
            for bins, t_ns, values in (
                (self._gyro, samples.t_gyro_ns, samples.w_NS_S_rad_s),
                (self._acc, samples.t_acc_ns, samples.f_NS_S_m_s2),
            ):
                usable = ~np.isnan(values[:, 0])
                late[usable] |= self._add(
                    bins, _ONLY, t_ns[usable], received_ns[usable], values[usable]
                )
            self._late["imu"] += int(late.sum())
        elif isinstance(samples, DeviceSamples):
            if samples.section in self._devices:
                bins, own = self._devices[samples.section], (samples.device, samples.t_ns)
                late = self._add(bins, *own, received_ns, samples.values)
                self._late[samples.section] += int(late.sum())
        else:
            late = self._add(self._attitude, _ONLY, samples.t_ns, received_ns, samples.q_NB_xyzw)
            self._late["star_tracker"] += int(late.sum())

    def close(self, now_ns: int, limit: int | None = None) -> list[Window]:
        """Close and return every window whose deadline has come; an empty one is marked missing.

        Windows from index `limit` on stay open. Of a longer gap the last MOST_EMPTY windows are
        returned.
        """
        windows: list[Window] = []
        if self._t0_ns is None or self._deadline(self._next) > now_ns:
            return windows
        self._sort_in()
        stop = (now_ns - self._lag_ns - self._t0_ns) // self._window_ns
        stop = stop if limit is None else min(stop, limit)
        while self._next < stop:
            if stop - self._next > MOST_EMPTY:
                self._skip_gap(stop)
            windows.append(self._close_next(self._t0_ns))
        return windows

    def _skip_gap(self, stop: int) -> None:
        """Skip empty windows before the next one with samples, all but the last MOST_EMPTY."""
        kinds = [self._joints, self._gyro, self._acc, self._attitude, *self._devices.values()]
        held = [bins.first() for bins in kinds]
        filled = min((index for index in held if index is not None), default=stop)
        following = min(filled, stop) - MOST_EMPTY
        if following > self._next:
            self.skipped += following - self._next
            self._next = following

    def _close_next(self, t0_ns: int) -> Window:
        index = self._next
        self._next += 1
        start_ns = t0_ns + index * self._window_ns
        stop_ns = start_ns + self._window_ns
        return Window(
            index=index,
            start_ns=start_ns,
            stop_ns=stop_ns,
            joints=self._joints.close(index, stop_ns),
            gyro=self._gyro.close(index, stop_ns)[0],
            accelerometer=self._acc.close(index, stop_ns)[0],
            attitude=self._attitude.close(index, stop_ns)[0],
            devices={name: bins.close(index, stop_ns) for name, bins in self._devices.items()},
        )

    def _deadline(self, index: int) -> int:
        return (self._t0_ns or 0) + (index + 1) * self._window_ns + self._lag_ns

    def _add(
        self,
        bins: _Bins,
        channel: IntArray,
        t_ns: IntArray,
        received_ns: IntArray,
        values: FloatArray,
    ) -> NDArray[np.bool_]:
        """Store values (k, width) of channels of one kind; return (k,) which came too late."""
        channel = np.broadcast_to(channel, t_ns.shape)
        t0_ns = self._t0_ns or 0
        index = (t_ns - t0_ns) // self._window_ns
        deadline_ns = t0_ns + (index + 1) * self._window_ns + self._lag_ns
        early = index < 0
        late = ~early & ((index < self._next) | (received_ns > deadline_ns))
        future = t_ns > received_ns + SPARE_WINDOWS * self._window_ns
        if np.count_nonzero(early | late | future):
            self._early += int(early.sum())
            self._future += int((future & ~late & ~early).sum())
            good = ~(early | late | future)
            channel, index, t_ns, values = channel[good], index[good], t_ns[good], values[good]
        if not len(index):
            return late
        first, last = int(index.min()), int(index.max())
        if first == last:
            self._overflow += bins.add(first, channel, t_ns, values)
            return late
        order = np.argsort(index, kind="stable")
        channel, index, t_ns, values = channel[order], index[order], t_ns[order], values[order]
        starts = np.append(0, np.flatnonzero(np.diff(index)) + 1)
        for start, stop in pairwise([*starts.tolist(), len(index)]):
            own = slice(start, stop)
            self._overflow += bins.add(int(index[start]), channel[own], t_ns[own], values[own])
        return late
