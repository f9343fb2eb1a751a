"""Joint nodes of one CAN bus: frames to calibrated samples, timed by SYNC."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from fsw.config import BusConfig, JointConfig
from fsw.drivers.codecs import canopen
from fsw.drivers.sources.bus_errors import BusErrors
from fsw.drivers.sources.counters import Counters
from fsw.drivers.sources.joint_track import JointTrack, calibrate
from fsw.drivers.sources.sync import SyncHistory
from fsw.drivers.wire import CanFrame, Reject
from fsw.messages import JointSample

LOST_AFTER_NS = 100_000_000  # a SYNC without a sample for so long counts as a lost sample
SILENT_AFTER_NS = 500_000_000
MAX_EVENTS = 256


class JointBusSource:
    """Every joint node of one bus.

    A sample's time of validity is the stamp of the SYNC that latched it plus the latch offset.
    Frames of other services are routed to events or ignored, and never count as rejects. A joint's
    lost samples are the SYNCs after its first accepted one that are 0.1 s old and have none.
    """

    def __init__(self, bus: BusConfig, joints: list[tuple[int, JointConfig]]) -> None:
        self._bus = bus
        self._latch_offset_ns = round(bus.latch_offset_s * 1e9)
        self._syncs = SyncHistory(bus.sync_counter_max, bus.rate_hz)
        self._unsettled: deque[tuple[int, int]] = deque()  # SYNC stamp and index
        period_s = 1.0 / bus.rate_hz
        self._tracks = {c.node_id: JointTrack(i, c, period_s) for i, c in joints}
        self._counts = Counters()  # what belongs to no joint
        self._states: dict[int, int] = {}
        self._other_frames = 0
        self._errors = BusErrors()
        self._events: deque[tuple[str, str, str]] = deque(maxlen=MAX_EVENTS)
        self.slow: dict[int, canopen.Tpdo2] = {}  # newest TPDO2 by joint index

    @property
    def counters(self) -> dict[str, int]:
        """Counters of the whole bus."""
        out = self._counts.as_dict()
        for track in self._tracks.values():
            for key, value in track.counts.as_dict().items():
                out[key] += value
        out["sync"] = self._syncs.count
        out["sync_lost"] = self._syncs.lost
        out["sync_invalid"] = self._syncs.invalid
        out["other_frames"] = self._other_frames
        out["error_frames"] = self._errors.frames
        out.update({f"can_{name}": count for name, count in self._errors.counts.items()})
        return out

    @property
    def joint_counters(self) -> dict[int, dict[str, int]]:
        """Counters by index of the joint."""
        return {t.index: t.counts.as_dict() for t in self._tracks.values()}

    @property
    def node_states(self) -> dict[int, int]:
        """NMT state by node, as last heard."""
        return dict(self._states)

    def events(self) -> list[tuple[str, str, str]]:
        """Return and forget what an operator should know: severity, code, text."""
        out = list(self._events)
        self._events.clear()
        return out

    def next_sync(self) -> tuple[int, bytes]:
        """Return COB-ID and data of the next SYNC to send; feed it back once sent."""
        return canopen.encode_sync(self._syncs.next_counter())

    def start_frames(self) -> list[tuple[int, bytes]]:
        """Return the NMT frames that start every configured node."""
        return [canopen.encode_nmt(canopen.NmtCommand.START, node) for node in self._tracks]

    def feed(self, frames: Sequence[CanFrame]) -> list[JointSample]:
        """Take frames in, sent SYNCs included, in order, and return the samples they hold."""
        samples = []
        first, last = canopen.COB_TPDO1, canopen.COB_TPDO1 | canopen.NODE_MASK
        for frame in frames:
            can_id = frame.can_id
            if frame.is_error:
                for severity, code, text in self._errors.feed(frame):
                    self._events.append((severity, code, f"{self._bus.name}: {text}"))
            elif frame.is_remote or frame.is_extended:
                self._other_frames += 1
            elif first < can_id <= last:
                sample = self._sample(frame)
                if sample is not None:
                    samples.append(sample)
            elif can_id == canopen.COB_SYNC:
                if self._syncs.add(frame.data, frame.t_ns):
                    self._settle(frame.t_ns)
            else:
                self._route(frame)
        return samples

    def _sample(self, frame: CanFrame) -> JointSample | None:
        track = self._tracks.get(frame.can_id & canopen.NODE_MASK)
        length = len(frame.data)
        if track is None:
            self._counts.received_bytes += length
            self._counts.reject(Reject.NODE, length)
            return None
        counts = track.counts
        counts.received_bytes += length
        fd = track.config.format == "fd"
        pdo = canopen.decode_fd(frame.data) if fd else canopen.decode_tpdo1(frame.data)
        if isinstance(pdo, Reject):
            counts.reject(pdo, length)
            return None
        if not canopen.usable(pdo.status):
            counts.reject(Reject.STATUS, length)
            return None
        sync = self._syncs.find(pdo.sync_counter, frame.t_ns)
        if sync is None:
            counts.reject(Reject.STALE, length)
            return None
        position, torque = calibrate(track.config, pdo.position_rad, pdo.torque_nm)
        reason = track.judge(sync[1], sync[0], position, torque)
        if reason is not None:
            counts.reject(reason, length)
            return None
        counts.accepted += 1
        counts.accepted_bytes += length
        if track.silent:
            track.silent = False
            self._event("info", "joint_back", track, "delivers samples again")
        t_ns = sync[0] + self._latch_offset_ns
        return JointSample(
            t_ns, frame.t_ns, track.index, pdo.sync_counter, position, torque, pdo.status
        )

    def _settle(self, now_ns: int) -> None:
        """Count the samples that did not come for SYNCs of some age."""
        self._unsettled.append((now_ns, self._syncs.count - 1))
        while self._unsettled[0][0] < now_ns - LOST_AFTER_NS:
            _, sync = self._unsettled.popleft()
            for track in self._tracks.values():
                if 0 <= track.first_sync < sync and not track.has(sync):
                    track.counts.lost += 1
                    if not track.silent and now_ns - track.last_t_ns > SILENT_AFTER_NS:
                        track.silent = True
                        self._event("medium", "joint_silent", track, "has sent no sample for 0.5 s")

    def _route(self, frame: CanFrame) -> None:
        """Take in the slower services of the configured nodes; everything else is not ours."""
        self._other_frames += 1
        function, node = frame.can_id & canopen.FUNCTION_MASK, frame.can_id & canopen.NODE_MASK
        track = self._tracks.get(node)
        if track is None or frame.can_id > 0x7FF:
            return
        if function == canopen.COB_TPDO2:
            slow = canopen.decode_tpdo2(frame.data)
            if not isinstance(slow, Reject):
                self.slow[track.index] = slow
        elif function == canopen.COB_EMCY:
            emergency = canopen.decode_emcy(frame.data)
            if not isinstance(emergency, Reject):
                text = f"emergency 0x{emergency.code:04x} register 0x{emergency.register:02x}"
                severity = "high" if emergency.code else "info"
                self._event(severity, "emergency", track, f"{text} {emergency.detail.hex()}")
        elif function == canopen.COB_HEARTBEAT:
            state = canopen.decode_heartbeat(frame.data)
            if not isinstance(state, Reject) and state != self._states.get(node):
                self._states[node] = state
                code = "boot_up" if state == canopen.NmtState.BOOT_UP else "node_state"
                self._event("info", code, track, f"NMT state 0x{state:02x}")

    def _event(self, severity: str, code: str, track: JointTrack, text: str) -> None:
        name = f"{track.config.name} (node 0x{track.config.node_id:02x})"
        self._events.append((severity, code, f"{self._bus.name}: {name}: {text}"))
