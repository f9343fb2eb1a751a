"""Samples to windows: every channel over one common interval, with missing and stale marks.

Window k is [t0 + k T, t0 + (k + 1) T) by time of validity and closes at its end + lag. Which
samples it holds depends on recorded stamps only, never on when the loop looked.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from fsw.config import Config
from fsw.messages import ChannelWindow, ImuSample, JointSample, Sample, Window

FRESHNESS_PERIODS = 5.0  # a channel silent for longer than this many sample periods is stale
SPARE_WINDOWS = 3  # open windows beyond those the lag needs; later validity times are absurd


@dataclass(slots=True)
class _Bin:
    """Samples of one channel in one open window, in order of arrival."""

    t_ns: list[int] = field(default_factory=list)
    values: list[tuple[float, ...]] = field(default_factory=list)


@dataclass(slots=True)
class _Channel:
    """One aligned channel and its bounded bins, by window index."""

    width: int
    min_count: int
    max_count: int
    freshness_ns: int
    bins: dict[int, _Bin] = field(default_factory=dict)
    newest_ns: int | None = None

    def close(self, index: int, stop_ns: int) -> ChannelWindow:
        held = self.bins.pop(index, None)
        if held is None:
            t_ns = np.empty(0, dtype=np.int64)
            values = np.empty((0, self.width))
        else:
            t_ns = np.array(held.t_ns, dtype=np.int64)
            values = np.array(held.values, dtype=np.float64).reshape(-1, self.width)
            if t_ns.size > 1 and bool(np.any(np.diff(t_ns) < 0)):
                order = np.argsort(t_ns, kind="stable")
                t_ns, values = t_ns[order], values[order]
            self.newest_ns = max(int(t_ns[-1]), self.newest_ns or int(t_ns[-1]))
        t_ns.setflags(write=False)
        values.setflags(write=False)
        stale = self.newest_ns is None or stop_ns - self.newest_ns > self.freshness_ns
        return ChannelWindow(
            t_ns=t_ns, values=values, missing=t_ns.size < self.min_count, stale=stale
        )


class Aligner:
    """Collect samples and hand out closed windows, in order and without gaps.

    Counters: `late` per source (validity in a window already closed, or received after its
    deadline), `early` (validity before t0), `future` (absurdly late validity), `overflow` (more
    samples than a window can hold).
    """

    def __init__(self, config: Config, n_joints: int) -> None:
        self._window_ns = round(config.estimator.window_s * 1e9)
        self._lag_ns = round(config.estimator.lag_s * 1e9)
        self._span = self._lag_ns // self._window_ns + 1 + SPARE_WINDOWS
        window_s, fill = config.estimator.window_s, config.estimator.min_fill_ratio

        def channel(width: int, rate_hz: float) -> _Channel:
            expected = rate_hz * window_s
            return _Channel(
                width=width,
                min_count=max(1, int(fill * expected)),
                max_count=int(4 * expected) + 16,
                freshness_ns=round(FRESHNESS_PERIODS / rate_hz * 1e9),
            )

        rates = {bus.name: bus.rate_hz for bus in config.buses}
        self._joints = [channel(2, rates[config.joints[i].bus]) for i in range(n_joints)]
        self._joint_names = [joint.name for joint in config.joints[:n_joints]]
        self._gyro = channel(3, config.imu.rate_hz)
        self._acc = channel(3, config.imu.rate_hz)
        self._attitude = channel(4, config.star_tracker.rate_hz if config.star_tracker else 1.0)
        self._t0_ns: int | None = None
        self._grid_ns: int | None = None  # of a run before, to be continued
        self._next = 0
        self._waiting: list[Sample] = []
        self.late: dict[str, int] = dict.fromkeys([*self._joint_names, "imu", "star_tracker"], 0)
        self.early = 0
        self.future = 0
        self.overflow = 0

    @property
    def started(self) -> bool:
        """Whether t0 is known."""
        return self._t0_ns is not None

    @property
    def next_index(self) -> int:
        """Index of the window that closes next."""
        return self._next

    def first_after(self, t_ns: int) -> int:
        """Return the index of the first window that begins at a time or after it."""
        if self._t0_ns is None:
            return 0
        return max(self._next, -((self._t0_ns - t_ns) // self._window_ns))

    @property
    def deadline_ns(self) -> int | None:
        """Receive stamp after which the next window takes nothing more; None before the start."""
        return None if self._t0_ns is None else self._deadline(self._next)

    @property
    def grid_ns(self) -> int | None:
        """Start of window 0 [ns]; None before the start."""
        return self._t0_ns if self._t0_ns is not None else self._grid_ns

    def resume(self, grid_ns: int) -> None:
        """Have the windows lie on the grid of a run before; it must lie in the past."""
        self._grid_ns = grid_ns

    def start(self, first_ns: int) -> None:
        """Fix the grid of windows at the first SYNC; samples pushed before are sorted in.

        A resumed grid stays as it is; its next window is the first that begins after the SYNC.
        """
        if self._t0_ns is not None:
            raise ValueError(f"already started at {self._t0_ns} ns")
        self._t0_ns = first_ns
        if self._grid_ns is not None:
            self._t0_ns = self._grid_ns
            self._next = -((self._grid_ns - first_ns) // self._window_ns)
        waiting, self._waiting = self._waiting, []
        for sample in waiting:
            self.push(sample)

    def push(self, sample: Sample) -> None:
        """Put one sample into the window its time of validity lies in."""
        if self._t0_ns is None:
            if len(self._waiting) < 4096:
                self._waiting.append(sample)
            else:
                self.overflow += 1
            return
        received = sample.t_receive_ns
        if isinstance(sample, JointSample):
            torque_nm = math.nan if sample.torque_nm is None else sample.torque_nm
            value = (sample.position_rad, torque_nm)
            late = self._add(self._joints[sample.joint], sample.t_ns, received, value)
            source = self._joint_names[sample.joint]
        elif isinstance(sample, ImuSample):
            late = False
            if sample.w_NS_S_rad_s is not None:
                late = self._add(self._gyro, sample.t_gyro_ns, received, sample.w_NS_S_rad_s)
            if sample.f_NS_S_m_s2 is not None:
                late |= self._add(self._acc, sample.t_acc_ns, received, sample.f_NS_S_m_s2)
            source = "imu"
        else:
            late = self._add(self._attitude, sample.t_ns, received, sample.q_NB_xyzw)
            source = "star_tracker"
        if late:
            self.late[source] += 1

    def close(self, now_ns: int) -> list[Window]:
        """Close every window whose deadline has come; empty ones too, marked missing."""
        windows: list[Window] = []
        if self._t0_ns is None:
            return windows
        while self._deadline(self._next) <= now_ns:
            windows.append(self._close_next(self._t0_ns))
        return windows

    def _close_next(self, t0_ns: int) -> Window:
        index = self._next
        self._next += 1
        start_ns = t0_ns + index * self._window_ns
        stop_ns = start_ns + self._window_ns
        return Window(
            index=index,
            start_ns=start_ns,
            stop_ns=stop_ns,
            joints=tuple(joint.close(index, stop_ns) for joint in self._joints),
            gyro=self._gyro.close(index, stop_ns),
            accelerometer=self._acc.close(index, stop_ns),
            attitude=self._attitude.close(index, stop_ns),
        )

    def _deadline(self, index: int) -> int:
        return (self._t0_ns or 0) + (index + 1) * self._window_ns + self._lag_ns

    def _add(self, channel: _Channel, t_ns: int, received_ns: int, value: Sequence[float]) -> bool:
        """Store one value; True when it came too late."""
        index = (t_ns - (self._t0_ns or 0)) // self._window_ns
        if index < 0:
            self.early += 1
            return False
        if index < self._next or received_ns > self._deadline(index):
            return True
        if index > self._next + self._span:
            self.future += 1
            return False
        held = channel.bins.get(index)
        if held is None:
            held = channel.bins[index] = _Bin()
        if len(held.t_ns) >= channel.max_count:
            self.overflow += 1
            return False
        held.t_ns.append(t_ns)
        held.values.append(tuple(value))
        return False
