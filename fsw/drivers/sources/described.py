"""Joints of one bus whose frames a description gives: frames to calibrated, timed samples."""

from collections import deque
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.config import BusConfig, HealthConfig, JointConfig
from fsw.config.signals import BY_SYNC, TimingConfig
from fsw.drivers.codecs.canopen import COB_SYNC
from fsw.drivers.layout.joints import (
    COUNTER,
    POSITION,
    STATUS,
    TIME,
    TORQUE,
    JointLayout,
    position_step_rad,
)
from fsw.drivers.sources.bus_errors import BusErrors
from fsw.drivers.sources.cues import COB_TIME, TIME_BITS, ByCue, ByTime, Cues, time_objects
from fsw.drivers.sources.described_frames import FrameReader
from fsw.drivers.sources.groups import Arrivals, Groupings
from fsw.drivers.sources.joint_end import JointEnd, Raw
from fsw.drivers.sources.joint_track import HISTORY_SYNCS
from fsw.drivers.sources.sync import UNKNOWN, SyncHistory, history_of
from fsw.drivers.sources.validity import (
    ASSUMED_BITRATE,
    ByArrival,
    ByDeviceTime,
    Validity,
    wire_s,
)
from fsw.drivers.wire import EFF_FLAG, ERR_FLAG, SFF_MASK, FrameArray, Reject, frame_at
from fsw.messages import FloatArray, IntArray, JointSamples, joined
from fsw.messages.findings import Fault, Finding

LATEST_RATIO = 0.9  # of a period: a later frame is not of the last SYNC
SPREAD_RATIO = 0.5  # of a period between the frames of one sample
REPEAT_NS = 100_000_000  # a joint that stays silent is reported again after this time
MAX_EVENTS = MAX_FINDINGS = 256
LATEST_S = 1.0  # age of a sample by the time of day that it holds
MOST_FRAMES = HISTORY_SYNCS // 2  # in a batch; a longer one is split, so that every loss is counted
ERROR_BUS_OFF = 0x040


class _Timed(NamedTuple):
    """Samples of all joints, sorted by joint; all arrays (k,), `values` (k, roles)."""

    joint: IntArray
    sent_ns: IntArray
    sent_row: IntArray
    done_ns: IntArray
    values: FloatArray


class DescribedBusSource:
    """Every described joint of one bus.

    A joint's sample is put together from the frames that its description names, and gets its time
    by the joint's own `timing`. Frames of no joint are ignored.
    """

    def __init__(
        self,
        bus: BusConfig,
        joints: Sequence[tuple[int, JointConfig]],
        layouts: Mapping[int, JointLayout],
        health: HealthConfig | None = None,
    ) -> None:
        self._bus = bus
        self._joints = [joint for _, joint in joints]
        self._layouts = [layouts[i] for i, _ in joints]
        period_s = 1.0 / bus.rate_hz
        self._period_ns = round(1e9 * period_s)
        self._silent_ns = round((health or HealthConfig()).silent_periods * self._period_ns)
        self._reader = FrameReader(self._layouts)
        steps_rad = [
            position_step_rad(*own) for own in zip(self._joints, self._layouts, strict=True)
        ]
        self._end = JointEnd(joints, period_s, steps_rad)
        timings = [_timing_of(joint) for joint in self._joints]
        self._groups = Groupings(
            [
                (len(layout.messages), round((own.spread_s or SPREAD_RATIO * period_s) * 1e9))
                for own, layout in zip(timings, self._layouts, strict=True)
            ]
        )
        self._delay_ns = np.array([round(own.delay_s * 1e9) for own in timings])
        self._offset_ns = round(bus.latch_offset_s * 1e9) * np.isin(
            [own.by for own in timings], [*BY_SYNC, "request"]
        )
        self._echoes = np.array([own.by == "echoed_counter" for own in timings])
        self._sync_cues = Cues([COB_SYNC])
        self._cues = {own.requests: Cues(_words(own)) for own in timings} | {(): self._sync_cues}
        self._validity = [
            _validity_of(bus, own, layout, self._cues[own.requests])
            for own, layout in zip(timings, self._layouts, strict=True)
        ]
        self._by_time = [own for own in self._validity if isinstance(own, ByTime)]
        statuses = [(joint.signals or {}).get("status") for joint in self._joints]
        self._mask = np.array([(own and own.mask) or 0 for own in statuses])
        self._wanted = np.array([(own and own.value) or 0 for own in statuses])
        self._syncs: SyncHistory = history_of(bus)
        self._heard_ns: list[int | None] = [None] * len(joints)
        self._reported_ns = [0] * len(joints)
        self._settled = [0] * len(joints)  # index up to which lost samples are counted
        self._errors, self._other_frames = BusErrors(), 0
        self._torque_unusable = 0
        self._events: deque[tuple[str, str, str]] = deque(maxlen=MAX_EVENTS)
        self._found: deque[Finding] = deque(maxlen=MAX_FINDINGS)

    @property
    def counters(self) -> dict[str, int]:
        """Counters of the whole bus."""
        out = self._end.counters()
        out["sync"] = self._sync_cues.count
        out["other_frames"] = self._other_frames
        out["error_frames"] = self._errors.frames
        out.update({f"can_{name}": count for name, count in self._errors.counts.items()})
        out["torque_unusable"] = self._torque_unusable
        out["incomplete"] = self._groups.headless
        return out

    @property
    def joint_counters(self) -> dict[int, dict[str, int]]:
        """Counters by index of the joint."""
        return self._end.joint_counters()

    @staticmethod
    def motor_side() -> dict[str, dict[str, float]]:
        """Return nothing: slow values of described joints are not read."""
        return {}

    def events(self) -> list[tuple[str, str, str]]:
        """Return the events since the last call: severity, code and text of each."""
        out = list(self._events)
        self._events.clear()
        return out

    def findings(self) -> list[Finding]:
        """Return the findings since the last call, in order of time."""
        found = sorted(self._found, key=lambda finding: finding.t_ns)
        self._found.clear()
        return found

    @property
    def words(self) -> list[int]:
        """Identifiers of the joints' frames, with flag bits."""
        return [int(word) for word in self._reader.words]

    def watch(self, now_ns: int, *, up: bool) -> None:
        """Report silent joints; a missing port (`up` is False) explains their silence."""
        for place, heard_ns in enumerate(self._heard_ns):
            if heard_ns is None:
                continue
            if not up:
                self._heard_ns[place] = None
            elif now_ns - max(heard_ns + self._silent_ns, self._reported_ns[place]) > 0:
                self._reported_ns[place] = now_ns + REPEAT_NS
                age_s = (now_ns - heard_ns) * 1e-9
                self._find(now_ns, Fault.JOINT_SILENT, place, f"no sample for {age_s:.3f} s")

    def feed(self, frames: FrameArray) -> JointSamples:
        """Accept frames in order, sent ones included, and return the samples they hold."""
        if len(frames) <= MOST_FRAMES:
            return self._feed(frames)
        cuts = range(MOST_FRAMES, len(frames), MOST_FRAMES)
        return joined([self._feed(part) for part in np.split(frames, cuts)])

    def _feed(self, frames: FrameArray) -> JointSamples:
        words = np.ascontiguousarray(frames["word"])
        is_own = np.isin(words, self._reader.words)
        for cues in self._cues.values():
            is_cue = words == cues.words[0] if len(cues.words) == 1 else np.isin(words, cues.words)
            cues.note(frames["t_ns"][is_cue].astype(np.int64))
            is_own |= is_cue
        if self._by_time and (is_time := words == COB_TIME).any():
            told = time_objects(frames[is_time])
            for own in self._by_time:
                own.note(told)
        self._other_frames += int(len(words) - np.count_nonzero(is_own))
        for row in np.flatnonzero(words & np.uint32(ERR_FLAG)).tolist():
            self._error(frames, row)
        if self._echoes.any():
            self._note_syncs(frames, np.flatnonzero(words == COB_SYNC))
        joint, arrivals, short = self._reader.read(frames, words)
        for place, at_ns, size in short:
            self._refuse(place, at_ns, Reject.LENGTH, size, f"{size} bytes")
        timed = self._grouped(joint, arrivals)
        index, t_ns = self._times(timed)
        return self._judged(timed, index, t_ns)

    def _note_syncs(self, frames: FrameArray, rows: NDArray[np.intp]) -> None:
        """Give SYNCs with a counter to the history for echoed ones."""
        for row in rows.tolist():
            data = frames["data"][row, : int(frames["length"][row])].tobytes()
            self._syncs.add(data, int(frames["t_ns"][row]), row)

    def _error(self, frames: FrameArray, row: int) -> None:
        frame = frame_at(frames, row)
        for severity, code, text in self._errors.feed(frame):
            self._events.append((severity, code, f"{self._bus.name}: {text}"))
        if frame.can_id & ERROR_BUS_OFF:
            text = "the controller went bus-off"
            self._found.append(Finding(frame.t_ns, Fault.BUS_OFF, self._bus.name, text))

    def _grouped(self, joint: IntArray, arrivals: Arrivals) -> _Timed:
        """Return the samples of all joints."""
        ends = np.flatnonzero(np.diff(joint, append=len(self._joints)))
        for place, t_ns in zip(joint[ends].tolist(), arrivals.t_ns[ends].tolist(), strict=True):
            self._heard_ns[place] = t_ns
        joint, group = self._groups.feed(joint, arrivals)
        return _Timed(joint, *group)

    def _times(self, timed: _Timed) -> tuple[IntArray, IntArray]:
        """Return the running index of every sample, UNKNOWN if it has no time, and its time."""
        index, t_ns = np.full(len(timed.joint), UNKNOWN), timed.sent_ns.copy()
        if (own := self._echoes[timed.joint]).any():
            counters = np.nan_to_num(timed.values[own, COUNTER]).astype(np.int64)
            rows = np.maximum(timed.sent_row[own], 0)
            order = np.argsort(rows, kind="stable")
            matched = self._syncs.match(counters[order], rows[order], timed.sent_ns[own][order])
            places = np.flatnonzero(own)[order]
            index[places] = np.where(matched.crept, UNKNOWN, matched.sync)
            t_ns[places] = matched.stamp_ns
        bounds = np.searchsorted(timed.joint, np.arange(len(self._joints) + 1)).tolist()
        for validity, start, stop in zip(self._validity, bounds[:-1], bounds[1:], strict=True):
            if validity is not None and stop > start:
                own_ns, device = timed.sent_ns[start:stop], timed.values[start:stop, TIME]
                index[start:stop], t_ns[start:stop] = validity.stamps(own_ns, device)
        return index, t_ns + (self._offset_ns - self._delay_ns)[timed.joint]

    def _judged(self, timed: _Timed, index: IntArray, t_ns: IntArray) -> JointSamples:
        """Return the samples that are usable; count and report the others."""
        joint, values = timed.joint, timed.values
        status = np.nan_to_num(values[:, STATUS]).astype(np.int64)
        good_status = status & self._mask[joint] == self._wanted[joint]
        good_status &= ~np.isnan(values[:, STATUS]) | (self._mask[joint] == 0)
        valid = good_status & np.isfinite(values[:, POSITION])
        usable = valid & (index >= 0)
        for k in np.flatnonzero(~usable).tolist():
            if index[k] < 0:
                self._refuse(joint[k], int(timed.done_ns[k]), Reject.STALE, 0, "no time")
            else:
                text = f"status 0x{status[k]:x}" if not good_status[k] else "the invalid value"
                self._refuse(joint[k], int(timed.done_ns[k]), Reject.STATUS, 0, text)
        raw = Raw(joint, index, t_ns, timed.done_ns, values[:, POSITION], values[:, TORQUE])
        judged = self._end.judge(raw, usable)
        for row, reason, fault in judged.refused:
            self._refuse(joint[row], int(timed.done_ns[row]), reason, 0, "", fault)
        for place, (track, count) in enumerate(zip(self._end.tracks, judged.counts, strict=True)):
            track.counts.accepted += count
            if track.newest > self._settled[place]:
                lost = track.counts.lost
                track.settle(self._settled[place], track.newest)
                self._settled[place] = track.newest
                if track.counts.lost > lost and count:
                    text = f"{track.counts.lost - lost} samples missing"
                    self._find(self._heard_ns[place] or 0, Fault.JOINT_LOST, place, text)
        self._torque_unusable += len(judged.silent)
        for k in judged.silent:
            self._find(int(timed.done_ns[k]), Fault.TORQUE_FAULT, int(joint[k]), "no torque")
        return judged.samples

    def _refuse(
        self,
        place: int,
        t_ns: int,
        reason: Reject,
        size: int,
        text: str,
        fault: Fault | None = None,
    ) -> None:
        """Count and report a sample or frame that is not used."""
        self._end.tracks[place].counts.reject(reason, size)
        known = {
            Reject.LENGTH: Fault.JOINT_LENGTH,
            Reject.STALE: Fault.JOINT_COUNTER,
            Reject.STATUS: Fault.ENCODER_FAULT,
        }
        if (found := fault or known.get(reason)) is not None:
            self._find(t_ns, found, place, text)

    def _find(self, t_ns: int, fault: Fault, place: int, text: str) -> None:
        self._found.append(Finding(t_ns, fault, self._joints[place].name, text))


def _timing_of(joint: JointConfig) -> TimingConfig:
    if joint.timing is None:
        raise ValueError(f"{joint.name}: no timing")
    return joint.timing


def _words(timing: TimingConfig) -> list[int]:
    """Return the identifiers of requests with flag bits."""
    return [own | EFF_FLAG * (own > SFF_MASK) for own in timing.requests]


def _validity_of(
    bus: BusConfig, timing: TimingConfig, layout: JointLayout, cues: Cues
) -> Validity | None:
    """Return what gives a joint's samples their times; None: the counter that they echo."""
    period_s, ppm = 1.0 / bus.rate_hz, timing.clock_tolerance_ppm
    wire_ns = wire_s(layout.messages[0], bus) * 1e9
    if timing.by == "arrival":
        return ByArrival(period_s, ppm, wire_ns)
    time = layout.use(TIME)
    if timing.by == "device_time" and time is not None:
        return ByDeviceTime(1 << time.signal.bits, time.factor, period_s, ppm, wire_ns)
    if timing.by == "time" and time is not None:
        told_ns = 1e9 * TIME_BITS / (bus.bitrate or ASSUMED_BITRATE)
        return ByTime(time.factor, period_s, ppm, told_ns, timing.latest_s or LATEST_S)
    if timing.by in ("last_sync", "request"):
        return ByCue(cues, round((timing.latest_s or LATEST_RATIO * period_s) * 1e9))
    return None
