"""Joint nodes of one CAN bus: frames to calibrated samples, timed by SYNC."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from fsw.config import BusConfig, HealthConfig, JointConfig
from fsw.drivers.codecs import canopen
from fsw.drivers.sources.bus_errors import BusErrors
from fsw.drivers.sources.bus_watch import BusWatch
from fsw.drivers.sources.counters import Counters
from fsw.drivers.sources.joint_track import JointTrack, calibrate
from fsw.drivers.sources.sync import SyncHistory
from fsw.drivers.wire import CanFrame, Reject
from fsw.messages import JointSample
from fsw.messages.findings import Fault, Finding

LOST_AFTER_NS = 100_000_000  # a SYNC without a sample for so long counts as a lost sample
MAX_EVENTS = 256
ERROR_BUS_OFF, ERROR_RESTARTED = 0x040, 0x100  # classes of a SocketCAN error frame
_FAULT_OF_REJECT = {
    Reject.LENGTH: Fault.JOINT_LENGTH,
    Reject.STALE: Fault.JOINT_COUNTER,
}
_FAULT_OF_STATUS = (  # first that holds; what makes the whole sample unusable
    (canopen.STATUS_TEST_DATA, Fault.NODE_TEST_DATA),
    (canopen.STATUS_SYNC_LOST, Fault.NODE_NO_SYNC),
    (0xFF, Fault.ENCODER_FAULT),
)


class JointBusSource:
    """Every joint node of one bus.

    A sample's time of validity is the stamp of the SYNC that latched it plus the latch offset.
    Frames of other services are routed to events or ignored, and never count as rejects. A joint's
    lost samples are the SYNCs after its first accepted one that are 0.1 s old and have none.
    """

    def __init__(
        self,
        bus: BusConfig,
        joints: list[tuple[int, JointConfig]],
        health: HealthConfig | None = None,
    ) -> None:
        health = health or HealthConfig()
        self._bus = bus
        self._watch = BusWatch(
            bus.name,
            {config.node_id: config.name for _, config in joints},
            bus.rate_hz,
            health.silent_periods,
            health.late_periods,
        )
        self._latch_offset_ns = round(bus.latch_offset_s * 1e9)
        self._syncs = SyncHistory(bus.sync_counter_max, bus.rate_hz)
        self._unsettled: deque[tuple[int, int]] = deque()  # SYNC stamp and index
        period_s = 1.0 / bus.rate_hz
        self._tracks = {c.node_id: JointTrack(i, c, period_s) for i, c in joints}
        self._counts = Counters()  # what belongs to no joint
        self._states: dict[int, int] = {}
        self._other_frames = 0
        self._errors = BusErrors()
        self._torque_unusable = 0
        self._events: deque[tuple[str, str, str]] = deque(maxlen=MAX_EVENTS)
        self._slow: dict[str, canopen.Tpdo2] = {}  # newest TPDO2 by joint

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
        out["sync_echoes"] = self._syncs.echoes
        out["other_frames"] = self._other_frames
        out["error_frames"] = self._errors.frames
        out.update({f"can_{name}": count for name, count in self._errors.counts.items()})
        out["torque_unusable"] = self._torque_unusable
        return out

    @property
    def joint_counters(self) -> dict[int, dict[str, int]]:
        """Counters by index of the joint."""
        return {t.index: t.counts.as_dict() for t in self._tracks.values()}

    @property
    def node_states(self) -> dict[int, int]:
        """NMT state by node, as last received."""
        return dict(self._states)

    def motor_side(self) -> dict[str, dict[str, float]]:
        """Return the newest slow values of every joint that sends TPDO2, in the joint's own sign.

        `velocity_rad_s`, `motor_torque_ratio` (of the rated torque), `temperature_degc`, by name.
        """
        signs = {track.config.name: track.config.sign for track in self._tracks.values()}
        return {
            name: {
                "velocity_rad_s": signs[name] * slow.velocity_rad_s,
                "motor_torque_ratio": signs[name] * slow.motor_torque_ratio,
                "temperature_degc": slow.temperature_c,
            }
            for name, slow in self._slow.items()
        }

    def events(self) -> list[tuple[str, str, str]]:
        """Return and forget what an operator should know: severity, code, text."""
        out = list(self._events)
        self._events.clear()
        return out

    def findings(self) -> list[Finding]:
        """Return and forget what was found wrong."""
        return self._watch.take()

    def watch(self, _now_ns: int, *, up: bool) -> None:
        """Note whether the bus has its port; missed SYNCs then report the silent nodes."""
        if not up:
            self._watch.without_port()

    def next_sync(self) -> tuple[int, bytes]:
        """Return COB-ID and data of the next SYNC to send; tell `sync_sent`, and feed it back."""
        return canopen.encode_sync(self._syncs.next_counter())

    def sync_sent(self) -> None:
        """Note that the SYNC was sent; it may be fed later."""
        self._syncs.issue()

    def start_frames(self) -> list[tuple[int, bytes]]:
        """Return the NMT frames that start every configured node."""
        return [canopen.encode_nmt(canopen.NmtCommand.START, node) for node in self._tracks]

    def feed(self, frames: Sequence[CanFrame]) -> list[JointSample]:
        """Accept frames in order, sent SYNCs included, and return the samples they hold."""
        samples = []
        first, last = canopen.COB_TPDO1, canopen.COB_TPDO1 | canopen.NODE_MASK
        for frame in frames:
            can_id = frame.can_id
            if frame.is_error:
                self._error(frame)
            elif frame.is_remote or frame.is_extended:
                self._other_frames += 1
                self._watch.stranger()
            elif first < can_id <= last:
                sample = self._sample(frame)
                if sample is not None:
                    samples.append(sample)
            elif can_id == canopen.COB_SYNC:
                if self._syncs.add(frame.data, frame.t_ns):
                    self._settle(frame.t_ns)
                    self._watch.sync(self._syncs.count - 1, frame.t_ns)
            else:
                self._route(frame)
        return samples

    def _error(self, frame: CanFrame) -> None:
        """Accept an error frame of the bus controller."""
        for severity, code, text in self._errors.feed(frame):
            self._events.append((severity, code, f"{self._bus.name}: {text}"))
        if frame.can_id & ERROR_BUS_OFF:
            self._watch.find(frame.t_ns, Fault.BUS_OFF, None, "the controller went bus-off")
        elif not frame.can_id & ERROR_RESTARTED:
            self._watch.find(frame.t_ns, Fault.BUS_ERRORS, None, f"class 0x{frame.can_id:03x}")

    def _sample(self, frame: CanFrame) -> JointSample | None:
        node = frame.can_id & canopen.NODE_MASK
        track = self._tracks.get(node)
        length = len(frame.data)
        if track is None:
            self._counts.received_bytes += length
            self._counts.reject(Reject.NODE, length)
            self._watch.stranger()
            self._watch.find(frame.t_ns, Fault.NODE_UNKNOWN, None, f"sample of node 0x{node:02x}")
            return None
        counts = track.counts
        counts.received_bytes += length
        fd = track.config.format == "fd"
        pdo = canopen.decode_fd(frame.data) if fd else canopen.decode_tpdo1(frame.data)
        sync = None
        reason: Reject | None = None
        if isinstance(pdo, Reject):
            reason = pdo
        else:
            sync = self._syncs.find(pdo.sync_counter, frame.t_ns)
            if sync is None:
                reason = Reject.STALE
        if isinstance(pdo, Reject) or sync is None or reason is not None:
            # whatever it says, the node is there and has answered the newest SYNC or the one before
            self._watch.answer_of_no_sync(node)
            self._refuse(track, frame, reason or Reject.STALE)
            return None
        self._watch.answer(node, sync[1], frame.t_ns)
        if not canopen.position_usable(pdo.status):
            fault = next(f for bits, f in _FAULT_OF_STATUS if pdo.status & bits or bits == 0xFF)
            self._watch.find(frame.t_ns, fault, node, f"status 0x{pdo.status:02x}")
            self._refuse(track, frame, Reject.STATUS)
            return None
        position, reading = calibrate(track.config, pdo.position_rad, pdo.torque_nm)
        torque: float | None = reading
        if not canopen.torque_usable(pdo.status):
            torque = None
        reason = track.judge(sync[1], sync[0], position, torque)
        if track.fault is not None:
            self._watch.find(frame.t_ns, track.fault, node)
        if reason is not None:
            self._refuse(track, frame, reason)
            return None
        if torque is None:
            self._torque_unusable += 1
            overload = pdo.status & canopen.STATUS_TORQUE_OVERLOAD
            fault = Fault.TORQUE_OVERLOAD if overload else Fault.TORQUE_FAULT
            self._watch.find(frame.t_ns, fault, node, f"status 0x{pdo.status:02x}")
        counts.accepted += 1
        counts.accepted_bytes += length
        t_ns = sync[0] + self._latch_offset_ns
        return JointSample(
            t_ns, frame.t_ns, track.index, pdo.sync_counter, position, torque, pdo.status
        )

    def _refuse(self, track: JointTrack, frame: CanFrame, reason: Reject) -> None:
        track.counts.reject(reason, len(frame.data))
        if reason in _FAULT_OF_REJECT:
            self._watch.find(frame.t_ns, _FAULT_OF_REJECT[reason], track.config.node_id)

    def _settle(self, now_ns: int) -> None:
        """Count the samples that did not come for SYNCs of some age."""
        self._unsettled.append((now_ns, self._syncs.count - 1))
        while self._unsettled[0][0] < now_ns - LOST_AFTER_NS:
            _, sync = self._unsettled.popleft()
            for track in self._tracks.values():
                if 0 <= track.first_sync < sync and not track.has(sync):
                    track.counts.lost += 1

    def _route(self, frame: CanFrame) -> None:
        """Accept the slower services of the configured nodes; everything else is not ours."""
        self._other_frames += 1
        function, node = frame.can_id & canopen.FUNCTION_MASK, frame.can_id & canopen.NODE_MASK
        track = self._tracks.get(node)
        if track is None or frame.can_id > 0x7FF:
            self._watch.stranger()
            return
        if function == canopen.COB_TPDO2:
            slow = canopen.decode_tpdo2(frame.data)
            if not isinstance(slow, Reject):
                self._slow[track.config.name] = slow
        elif function == canopen.COB_EMCY:
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
                self._watch.boot(node, frame.t_ns)

    def _event(self, severity: str, code: str, track: JointTrack, text: str) -> None:
        name = f"{track.config.name} (node 0x{track.config.node_id:02x})"
        self._events.append((severity, code, f"{self._bus.name}: {name}: {text}"))
