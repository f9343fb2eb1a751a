"""Joints of one bus whose frames a description gives: frames to calibrated, timed samples."""

from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np

from fsw.config import BusConfig, HealthConfig, JointConfig
from fsw.drivers.layout.joints import POSITION, TORQUE, Layout, position_step_rad
from fsw.drivers.sources.bus_errors import BusReports
from fsw.drivers.sources.described_samples import DescribedSamples, Timed
from fsw.drivers.sources.joint_end import JointEnd, Raw
from fsw.drivers.sources.joint_track import HISTORY_SYNCS
from fsw.drivers.sources.line_watch import LineWatch, silent_only
from fsw.drivers.wire import ERR_FLAG, FrameArray, Reject, frame_at
from fsw.messages import JointSamples, joined
from fsw.messages.findings import Fault, Finding

MAX_FINDINGS = 256
MOST_FRAMES = HISTORY_SYNCS // 2  # in a batch; a longer one is split, so that every loss is counted


class DescribedBusSource:
    """Every described joint of one bus.

    A joint's sample is put together from the frames that its description names, and gets its time
    by the joint's own `timing`. Frames of no joint are ignored.
    """

    def __init__(
        self,
        bus: BusConfig,
        joints: Sequence[tuple[int, JointConfig]],
        layouts: Mapping[int, Layout],
        health: HealthConfig | None = None,
    ) -> None:
        self._bus = bus
        self._joints = [joint for _, joint in joints]
        own = [layouts[i] for i, _ in joints]
        period_s = 1.0 / bus.rate_hz
        silent_periods = (health or HealthConfig()).silent_periods
        line = silent_only(Fault.JOINT_SILENT)
        self._watches = [
            LineWatch(line, joint.name, 1e9 * period_s, silent_periods) for joint in self._joints
        ]
        self._samples = DescribedSamples(bus, own, [bus.rate_hz] * len(joints))
        self._heard_ns = self._samples.heard_ns
        steps_rad = [position_step_rad(*pair) for pair in zip(self._joints, own, strict=True)]
        self._end = JointEnd(joints, period_s, steps_rad)
        self._settled = [0] * len(joints)  # index up to which lost samples are counted
        self._reports = BusReports(bus.name)
        self.events = self._reports.events
        self._found: deque[Finding] = deque(maxlen=MAX_FINDINGS)

    @property
    def counters(self) -> dict[str, int]:
        """Counters of the whole bus."""
        own = {"sync": self._samples.sync_count, "incomplete": self._samples.headless}
        return self._end.counters() | self._reports.counters() | own

    @property
    def joint_counters(self) -> dict[int, dict[str, int]]:
        """Counters by index of the joint."""
        return self._end.joint_counters()

    @staticmethod
    def motor_side() -> dict[str, dict[str, float]]:
        """Return nothing: slow values of described joints are not read."""
        return {}

    def findings(self) -> list[Finding]:
        """Return the findings since the last call, in order of time."""
        silent = [finding for watch in self._watches for finding in watch.take()]
        found = sorted([*self._found, *silent], key=lambda finding: finding.t_ns)
        self._found.clear()
        return found

    @property
    def words(self) -> list[int]:
        """Identifiers of the joints' frames, with flag bits."""
        return [int(word) for word in self._samples.words]

    def watch(self, now_ns: int, *, up: bool) -> None:
        """Report silent joints; a missing port (`up` is False) explains their silence."""
        for place, watch in enumerate(self._watches):
            heard_ns = self._heard_ns[place] = self._heard_ns[place] if up else None
            if heard_ns is not None:
                watch.followed(heard_ns)
            watch.watch(now_ns, up=up)

    def feed(self, frames: FrameArray) -> JointSamples:
        """Accept frames in order, sent ones included, and return the samples they hold."""
        if len(frames) <= MOST_FRAMES:
            return self._feed(frames)
        cuts = range(MOST_FRAMES, len(frames), MOST_FRAMES)
        return joined([self._feed(part) for part in np.split(frames, cuts)])

    def _feed(self, frames: FrameArray) -> JointSamples:
        for row in np.flatnonzero(frames["word"] & np.uint32(ERR_FLAG)).tolist():
            frame = frame_at(frames, row)
            if (found := self._reports.error(frame)) is not None:
                self._found.append(Finding(frame.t_ns, found[0], self._bus.name, found[1]))
        timed, short = self._samples.read(frames)
        self._reports.other_frames += self._samples.others(frames)
        for place, at_ns, size in short:
            self._refuse(place, at_ns, Reject.LENGTH, size, f"{size} bytes")
        return self._judged(timed)

    def _judged(self, timed: Timed) -> JointSamples:
        """Return the samples that are usable; count and report the others."""
        joint, index, t_ns, _, values, status, good_status, crept = timed
        usable = good_status & np.isfinite(values[:, POSITION]) & (index >= 0)
        for k in np.flatnonzero(~usable).tolist():
            if index[k] < 0:
                fault = Fault.SYNC_CREEPS if crept[k] else None
                self._refuse(joint[k], int(timed.done_ns[k]), Reject.STALE, 0, "no time", fault)
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
        self._reports.torque_unusable += len(judged.silent)
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
        found = fault or known.get(reason)
        if found is Fault.SYNC_CREEPS:  # of the bus
            self._found.append(Finding(t_ns, found, self._bus.name, self._samples.movement))
        elif found is not None:
            self._find(t_ns, found, place, text)

    def _find(self, t_ns: int, fault: Fault, place: int, text: str) -> None:
        self._found.append(Finding(t_ns, fault, self._joints[place].name, text))
