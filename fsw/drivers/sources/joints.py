"""Joint nodes of one CAN bus: frames to calibrated samples, timed by SYNC."""

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsw.config import BusConfig, HealthConfig, JointConfig
from fsw.drivers.codecs import canopen
from fsw.drivers.layout.shipped import (
    JOINT,
    JOINT_FD,
    JOINT_SLOW,
    READ_JOINT,
    READ_JOINT_FD,
    READ_JOINT_SLOW,
    READ_SPEED_FD,
)
from fsw.drivers.sources.bus_errors import BusReports
from fsw.drivers.sources.bus_watch import Answers, BusWatch, Mark
from fsw.drivers.sources.counters import Counters
from fsw.drivers.sources.joint_end import JointEnd, Raw
from fsw.drivers.sources.joint_track import HISTORY_SYNCS, JointTrack
from fsw.drivers.sources.sync import UNKNOWN, history_of
from fsw.drivers.wire import MAX_DATA_BYTES, CanFrame, FrameArray, Reject, frame_at, picked
from fsw.messages import IntArray, JointSamples, joined
from fsw.messages.findings import Fault, Finding

LOST_AFTER_NS = 100_000_000  # a SYNC without a sample after this time counts as a lost sample
MOST_SYNCS = HISTORY_SYNCS // 2  # per batch; a longer batch is split, so that every loss is counted
READERS = (READ_JOINT, READ_JOINT_FD, READ_SPEED_FD)  # a classic node sends speed as its position
_FAULT_OF_REJECT = {
    Reject.LENGTH: Fault.JOINT_LENGTH,
    Reject.STALE: Fault.JOINT_COUNTER,
}
_FAULT_OF_STATUS = (  # the first match gives the fault of an unusable sample
    (canopen.STATUS_TEST_DATA, Fault.NODE_TEST_DATA),
    (canopen.STATUS_SYNC_LOST, Fault.NODE_NO_SYNC),
    (0xFF, Fault.ENCODER_FAULT),
)


class JointBusSource:
    """Every joint node of one bus.

    A sample's time of validity is the stamp of the SYNC that latched it plus the latch offset.
    Frames of other services become events or are ignored; they never count as rejects. A sample is
    lost if a SYNC after the joint's first accepted sample has no sample after 0.1 s.
    """

    words: tuple[int, ...] = ()  # of frames that begin the grid of windows: a SYNC does

    def __init__(
        self,
        bus: BusConfig,
        joints: list[tuple[int, JointConfig]],
        health: HealthConfig | None = None,
    ) -> None:
        health = health or HealthConfig()
        self._watch = BusWatch(
            bus.name,
            {config.node_id: config.name for _, config in joints if config.node_id is not None},
            bus.rate_hz,
            health.silent_periods,
            health.late_periods,
        )
        self._syncs = history_of(bus)
        self._unsettled: deque[tuple[int, int]] = deque()  # SYNC stamp and index
        offset_ns = round(bus.latch_offset_s * 1e9)
        self._end = JointEnd(joints, 1.0 / bus.rate_hz, on_wire=True, offset_ns=offset_ns)
        self._tracks = self._end.tracks
        configs = [config for _, config in joints]
        self._ids = np.array([config.node_id for config in configs], np.int64)
        self._place = np.full(canopen.NODE_MASK + 1, -1)  # of a node's joint in `joints`; -1: none
        self._place[self._ids] = np.arange(len(joints))
        is_fd = np.array([config.format == "fd" for config in configs], np.bool_)
        self._readers = is_fd * np.array([1 + config.speed_only for config in configs], np.int64)
        self._kinds = sorted(set(self._readers.tolist())) or [0]
        self._lengths = np.where(is_fd, JOINT_FD.length, JOINT.length)
        self._counts = Counters()  # of frames of no configured joint
        self._states: dict[int, int] = {}
        self._reports = BusReports(bus.name)
        self.events = self._reports.events
        self._slow: dict[int, NDArray[np.uint8]] = {}  # data of the newest TPDO2, by place

    @property
    def counters(self) -> dict[str, int]:
        """Counters of the whole bus."""
        out = self._counts.as_dict()
        out = {key: value + out[key] for key, value in self._end.counters().items()}
        out["sync"] = self._syncs.count
        out["sync_lost"] = self._syncs.lost
        out["sync_invalid"] = self._syncs.invalid
        out["sync_echoes"] = self._syncs.echoes
        return out | self._reports.counters()

    @property
    def joint_counters(self) -> dict[int, dict[str, int]]:
        """Counters by index of the joint."""
        return self._end.joint_counters()

    @property
    def node_states(self) -> dict[int, int]:
        """NMT state by node, as last received."""
        return dict(self._states)

    def motor_side(self) -> dict[str, dict[str, float]]:
        """Return the newest TPDO2 values of every joint that sends them, by name of the joint.

        `velocity_rad_s` and `motor_torque_ratio` (of the rated torque) have the joint's configured
        sign; `temperature_degc` is the third value.
        """
        values = {}
        for place, data in sorted(self._slow.items()):
            joint = self._tracks[place].config
            velocity, torque, temperature = (float(own[0]) for own in READ_JOINT_SLOW(data[None]))
            values[joint.name] = {
                "velocity_rad_s": self._end.calibration.rate(place, velocity),
                "motor_torque_ratio": joint.sign * torque,
                "temperature_degc": temperature,
            }
        return values

    def findings(self) -> list[Finding]:
        """Return the findings since the last call."""
        return self._watch.take()

    def watch(self, _now_ns: int, *, up: bool) -> None:
        """Record whether the bus has its port (`up`); a missing port explains missing answers."""
        if not up:
            self._watch.without_port()

    def feed(self, frames: FrameArray) -> JointSamples:
        """Accept frames in order, sent SYNCs included, and return the samples they hold."""
        ends = np.flatnonzero(frames["word"] == canopen.COB_SYNC)[MOST_SYNCS::MOST_SYNCS]
        if not ends.size:
            return self._feed(frames)
        return joined([self._feed(part) for part in np.split(frames, ends)])

    def _feed(self, frames: FrameArray) -> JointSamples:
        words = np.ascontiguousarray(frames["word"])
        is_answer = (words > canopen.COB_TPDO1) & (
            words <= canopen.COB_TPDO1 | canopen.NODE_MASK
        )  # no flag bits: base format
        is_slow = (words > canopen.COB_TPDO2) & (words <= canopen.COB_TPDO2 | canopen.NODE_MASK)
        if np.count_nonzero(is_slow):
            is_slow[is_slow] = self._place[words[is_slow] & canopen.NODE_MASK] >= 0
            self._slow_values(picked(frames, is_slow))
        rows = np.flatnonzero(is_answer)
        node = self._place[words[rows] & canopen.NODE_MASK]
        syncs, others = self._others(frames, np.flatnonzero(~(is_answer | is_slow)))
        if np.count_nonzero(node < 0):
            others += self._unknown(frames, rows[node < 0])
            rows, node = rows[node >= 0], node[node >= 0]
        samples = self._answers(frames.take(rows), rows, node, syncs, others)
        if syncs:
            self._settle(syncs)
        return samples

    def _slow_values(self, frames: FrameArray) -> None:
        """Keep the newest TPDO2 of every joint; `motor_side` decodes it."""
        self._reports.other_frames += len(frames)
        whole = picked(frames, frames["length"] == JOINT_SLOW.length)
        places = self._place[whole["word"] & canopen.NODE_MASK].tolist()
        self._slow.update(zip(places, whole["data"], strict=True))

    def _others(self, frames: FrameArray, rows: NDArray[np.intp]) -> tuple[list[Mark], list[Mark]]:
        """Accept SYNCs, error frames and other services; return marks of SYNCs and of others."""
        syncs: list[Mark] = []
        others: list[Mark] = []
        part = frames.take(rows)
        is_sync = part["word"] == canopen.COB_SYNC
        own = picked(part, is_sync)
        if len(own) and (own["length"] == 1).all():
            first, places, stamps_ns = self._syncs.count, rows[is_sync], own["t_ns"].tolist()
            if self._syncs.follow(own["data"][:, 0].tolist(), stamps_ns, places.tolist()):
                indexes = range(first, self._syncs.count)
                syncs += map(Mark, places.tolist(), stamps_ns, indexes)
                rows, part = rows[~is_sync], picked(part, ~is_sync)
        data, width = part["data"].tobytes(), MAX_DATA_BYTES
        columns = (rows, part["word"], part["length"], part["t_ns"])
        items = zip(*(column.tolist() for column in columns), strict=True)
        for k, (row, word, length, t_ns) in enumerate(items):
            if word == canopen.COB_SYNC:
                if self._syncs.add(data[k * width : k * width + length], t_ns, row):
                    syncs.append(Mark(row, t_ns, sync=self._syncs.count - 1))
                continue
            frame = frame_at(frames, row)
            if frame.is_error:
                if (found := self._reports.error(frame)) is not None:
                    self._watch.find(frame.t_ns, found[0], None, found[1])
            elif frame.is_remote or frame.is_extended:
                self._reports.other_frames += 1
                others.append(Mark(row, t_ns))
            else:
                others += self._route(frame, row)
        return syncs, others

    def _unknown(self, frames: FrameArray, rows: NDArray[np.intp]) -> list[Mark]:
        """Reject samples of nodes that are not configured; return a mark of each."""
        for row in rows.tolist():
            frame = frame_at(frames, row)
            self._counts.received_bytes += len(frame.data)
            self._counts.reject(Reject.NODE, len(frame.data))
            text = f"sample of node 0x{frame.can_id & canopen.NODE_MASK:02x}"
            self._watch.find(frame.t_ns, Fault.NODE_UNKNOWN, None, text)
        return [Mark(row, int(frames["t_ns"][row])) for row in rows.tolist()]

    def _answers(
        self,
        frames: FrameArray,
        rows: NDArray[np.intp],
        node: IntArray,
        syncs: list[Mark],
        others: list[Mark],
    ) -> JointSamples:
        """Return the good samples of TPDO1 frames (k,); `node` (k,) is the place of each joint."""
        t_ns, length = frames["t_ns"], frames["length"]
        whole = length == self._lengths[node]
        position_rad, torque_nm, status, counter = self._decode(frames["data"], node)
        counter[~whole] = 0  # of no SYNC
        index, sync_ns, newest, crept = self._syncs.match(counter, rows, t_ns)
        index[~whole] = UNKNOWN
        self._watch.feed(Answers(self._ids[node], index, newest, rows, t_ns), syncs, others)
        usable = (index >= 0) & ~crept & canopen.position_usable(status)
        torque_nm[~canopen.torque_usable(status)] = np.nan
        self._count_received(node, length)
        if np.count_nonzero(usable) < len(usable):
            places = np.flatnonzero(~usable)
            self._refuse_unused(frames, node, places, whole, index, crept, status)
        raw = Raw(node, index, sync_ns, t_ns, position_rad, torque_nm)
        judged = self._end.judge(raw, usable, t_ns - sync_ns <= LOST_AFTER_NS)
        for row, reason, fault in judged.refused:
            track = self._tracks[node[row]]
            track.counts.reject(reason, int(length[row]))
            if fault is not None:
                self._watch.find(int(t_ns[row]), fault, track.config.node_id)
        sizes = zip(self._tracks, self._lengths.tolist(), judged.counts, strict=True)
        for track, size, count in sizes:
            track.counts.accepted += count
            track.counts.accepted_bytes += count * size
        self._report_torques(frames, node, judged.silent, status)
        return judged.samples

    def _decode(self, data: NDArray[np.uint8], node: IntArray) -> list[NDArray[Any]]:
        """Return position, torque, status and counter of frames in the format of their joints."""
        parts = [READERS[kind](data) for kind in self._kinds]
        if len(parts) == 1:
            return parts[0]
        is_of = [self._readers[node] == kind for kind in self._kinds]
        return [np.select(is_of, own) for own in zip(*parts, strict=True)]

    def _count_received(self, node: IntArray, length: NDArray[np.uint8]) -> None:
        sizes = np.bincount(node, weights=length, minlength=len(self._lengths)).tolist()
        for track, size in zip(self._tracks, sizes, strict=True):
            track.counts.received_bytes += int(size)

    def _refuse_unused(
        self,
        frames: FrameArray,
        nodes: IntArray,
        places: NDArray[np.intp],
        whole: NDArray[np.bool_],
        index: IntArray,
        crept: NDArray[np.bool_],
        status: IntArray,
    ) -> None:
        """Reject frames of a wrong length, without a time, or whose status forbids their use."""
        for place in places.tolist():
            track = self._tracks[nodes[place]]
            node = track.config.node_id
            t_ns, length = int(frames["t_ns"][place]), int(frames["length"][place])
            if index[place] < 0:
                reason = Reject.STALE if whole[place] else Reject.LENGTH
                self._watch.find(t_ns, _FAULT_OF_REJECT[reason], node)
            elif crept[place]:
                reason = Reject.STALE
                self._watch.find(t_ns, Fault.SYNC_CREEPS, None, self._syncs.movement)
            else:
                reason, bits = Reject.STATUS, int(status[place])
                fault = next(f for mask, f in _FAULT_OF_STATUS if bits & mask or mask == 0xFF)
                self._watch.find(t_ns, fault, node, f"status 0x{bits:02x}")
            track.counts.reject(reason, length)

    def _report_torques(
        self, frames: FrameArray, node: IntArray, places: list[int], status: IntArray
    ) -> None:
        """Count and report accepted samples whose torque cannot be used."""
        for place in places:
            self._reports.torque_unusable += 1
            bits = int(status[place])
            overload = bits & canopen.STATUS_TORQUE_OVERLOAD
            fault = Fault.TORQUE_OVERLOAD if overload else Fault.TORQUE_FAULT
            t_ns, owner = int(frames["t_ns"][place]), int(self._ids[node[place]])
            self._watch.find(t_ns, fault, owner, f"status 0x{bits:02x}")

    def _settle(self, syncs: list[Mark]) -> None:
        """Count the missing samples of SYNCs that are older than `LOST_AFTER_NS`."""
        waiting = self._unsettled
        waiting += [(mark.t_ns, mark.sync) for mark in syncs]
        before_ns = syncs[-1].t_ns - LOST_AFTER_NS
        first = waiting[0][1]
        while waiting[0][0] < before_ns:
            waiting.popleft()
        if waiting[0][1] > first:
            for track in self._tracks:
                track.settle(first, waiting[0][1])

    def _route(self, frame: CanFrame, row: int) -> list[Mark]:
        """Accept emergencies and heartbeats; return a mark of a boot-up or an unknown node."""
        self._reports.other_frames += 1
        function, node = frame.can_id & canopen.FUNCTION_MASK, frame.can_id & canopen.NODE_MASK
        place = int(self._place[node])
        if place < 0:
            return [Mark(row, frame.t_ns)]
        track = self._tracks[place]
        if function == canopen.COB_EMCY:
            emergency = canopen.decode_emcy(frame.data)
            if not isinstance(emergency, Reject):
                text = f"emergency 0x{emergency.code:04x} register 0x{emergency.register:02x}"
                severity = "high" if emergency.code else "info"
                self._event(severity, "NODE_EMERGENCY", track, f"{text} {emergency.detail.hex()}")
        elif function == canopen.COB_HEARTBEAT:
            state = canopen.decode_heartbeat(frame.data)
            if not isinstance(state, Reject) and state != self._states.get(node):
                self._states[node] = state
                code = "NODE_BOOT_UP" if state == canopen.NmtState.BOOT_UP else "NODE_STATE"
                self._event("info", code, track, f"NMT state 0x{state:02x}")
            if state == canopen.NmtState.BOOT_UP:
                return [Mark(row, frame.t_ns, booted=node)]
        return []

    def _event(self, severity: str, code: str, track: JointTrack, text: str) -> None:
        name = f"{track.config.name} (node 0x{track.config.node_id:02x})"
        self._reports.event(severity, code, f"{name}: {text}")
