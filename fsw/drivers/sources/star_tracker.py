"""Star tracker: serial chunks to attitudes of the spacecraft bus."""

from collections.abc import Sequence

import numpy as np

from fsw.config import HealthConfig, StarTrackerConfig
from fsw.drivers.codecs.attitude_datagram import AttitudeDatagram
from fsw.drivers.codecs.entries import star_tracker_codec
from fsw.drivers.codecs.framing import Frame
from fsw.drivers.sources.arrival import ArrivalTracker
from fsw.drivers.sources.clock_model import ClockModel
from fsw.drivers.sources.counters import Counters, serial_counters
from fsw.drivers.sources.line_watch import TRACKER_LINE, LineWatch
from fsw.drivers.wire import ByteChunk, Reject
from fsw.messages import AttitudeSamples
from fsw.messages.findings import Fault, Finding

SUBJECT = "star_tracker"
CLOCK_TOLERANCE_PPM = 200.0
JUMP_NS = 500_000_000  # largest difference of unit and host time from one solution to the next
PERIOD_RATIO = 0.5  # of a period: least spacing of solutions, and most lead on the clock model
_FAULT_OF_REJECT = {Reject.STATUS: Fault.TRACKER_BLIND, Reject.RANGE: Fault.TRACKER_RANGE}
CHAIN = 3  # this many solutions in order are believed to be the unit's new time

Quaternion = tuple[float, float, float, float]
_Sample = tuple[int, int, Quaternion]  # time of validity and of receipt [ns], attitude
NO_SAMPLES = AttitudeSamples(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 4)))


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the Hamilton product of quaternions x y z w: rotation b, then a."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def conjugate(q: Quaternion) -> Quaternion:
    """Return the inverse rotation of a unit quaternion x y z w."""
    return (-q[0], -q[1], -q[2], q[3])


def to_bus(q_wxyz: Quaternion, q_BS_xyzw: Quaternion, rotation: str) -> Quaternion:
    """Return q_NB_xyzw, which takes B components to N, from the unit's quaternion.

    With rotation `inertial_to_tracker` the unit's quaternion takes N components to S; with
    `tracker_to_inertial` it takes S components to N.
    """
    w, x, y, z = q_wxyz
    scale = (w * w + x * x + y * y + z * z) ** -0.5
    q = (x * scale, y * scale, z * scale, w * scale)
    q_NS = conjugate(q) if rotation == "inertial_to_tracker" else q
    return multiply(q_NS, conjugate(q_BS_xyzw))


class StarTrackerSource:
    """One star tracker; solutions are timed by the unit's stamp, or by arrival minus latency."""

    def __init__(self, config: StarTrackerConfig, health: HealthConfig | None = None) -> None:
        health = health or HealthConfig()
        self._config = config
        period_ns = 1e9 / config.rate_hz
        self._watch = LineWatch(TRACKER_LINE, SUBJECT, period_ns, health.silent_periods)
        self._late_ns = health.tracker_late_s * 1e9
        self._codec = star_tracker_codec(config)
        self._arrivals = ArrivalTracker(config.baud_rate)
        self._clock = ClockModel(1e-6, CLOCK_TOLERANCE_PPM)
        self._counts = Counters()
        self._latency_ns = config.latency_s * 1e9
        self._period_ns = 1e9 / config.rate_hz
        self._last: tuple[int, int] | None = None  # unit time [us], host stamp [ns]
        self._last_frame = b""
        self._doubted: tuple[int, int] | None = None
        self._chain = 0
        self._waited_ns = 0.0  # longest time that the frame may have waited to be read

    @property
    def counters(self) -> dict[str, int]:
        """Counters of samples and bytes."""
        return serial_counters(self._counts, self._codec.framer)

    def lacks(self) -> str:
        """Return nothing: a solution has all data that are used."""
        return ""

    def findings(self) -> list[Finding]:
        """Return the findings since the last call."""
        return self._watch.take()

    def watch(self, now_ns: int, *, up: bool) -> None:
        """Find out whether the unit is silent; call this after feeding all that was received."""
        self._watch.watch(now_ns, up=up)

    def feed(self, chunks: Sequence[ByteChunk]) -> AttitudeSamples:
        """Accept chunks in order and return the attitudes they complete."""
        samples: list[_Sample] = []
        for chunk in chunks:
            frames = [(f, self._codec.decode(f.data)) for f in self._codec.framer.feed(chunk)]
            sent_us = {item.unix_us for _, item in frames if isinstance(item, AttitudeDatagram)}
            most_ns = chunk.t_ns - self._last[1] if self._last and len(sent_us) > 1 else 0
            for frame, decoded in frames:
                self._waited_ns = min(self._wait_ns(decoded, sent_us), most_ns)
                sample = self._take(frame, decoded)
                if sample is not None:
                    samples.append(sample)
        if not samples:
            return NO_SAMPLES
        t_ns, t_receive_ns, attitudes = zip(*samples, strict=True)
        return AttitudeSamples(np.array(t_ns), np.array(t_receive_ns), np.array(attitudes))

    def _wait_ns(self, decoded: object, sent_us: set[int]) -> float:
        """Return how long a frame may have waited to be read [ns], from unit times in its chunk.

        A unit sends a solution as soon as it exists. So two solutions in one chunk waited to be
        read: the newest for up to a period, the others longer.
        """
        if not isinstance(decoded, AttitudeDatagram):
            return 0.0
        return (max(sent_us) - decoded.unix_us) * 1e3 + self._period_ns

    def _take(self, frame: Frame, decoded: object) -> _Sample | None:
        length = len(frame.data)
        t_ns = frame.pieces[-1].t_ns
        if isinstance(decoded, Reject):
            self._refuse(frame, decoded, _FAULT_OF_REJECT.get(decoded, Fault.TRACKER_DAMAGED))
            return None
        if not isinstance(decoded, AttitudeDatagram):
            self._counts.accepted_bytes += length
            return None
        restart = False
        if not self._is_next(decoded.unix_us, t_ns, frame.data):
            restart = self._is_chain(decoded.unix_us, t_ns)
            if not restart:
                again = frame.data == self._last_frame
                fault = Fault.TRACKER_DUPLICATE if again else Fault.TRACKER_CLOCK
                self._refuse(frame, Reject.SEQUENCE, fault)
                return None
        lost = 0 if restart else self._count_lost(decoded.unix_us, t_ns)
        self._last, self._last_frame, self._chain = (decoded.unix_us, t_ns), frame.data, 0
        sample_ns, late_ns = self._time_of_validity(frame, decoded, restart)
        self._watch.accepted(t_ns, frame.skipped, lost, length)
        late = late_ns > self._late_ns + self._waited_ns
        if late:
            text = f"{late_ns * 1e-6:.0f} ms later than its own clock allows"
            self._watch.find(t_ns, Fault.TRACKER_LATE, text)
        if late or (self._waited_ns > 0.0 and self._config.time == "arrival"):
            self._counts.reject(Reject.STALE, length)
            return None
        self._counts.accepted += 1
        self._counts.accepted_bytes += length
        q_BS, rotation = self._config.mounting.q_BS_xyzw, self._config.rotation
        return sample_ns, t_ns, to_bus(decoded.q_wxyz, q_BS, rotation)

    def _refuse(self, frame: Frame, reason: Reject, fault: Fault) -> None:
        self._counts.reject(reason, len(frame.data))
        self._watch.find(frame.pieces[-1].t_ns, fault)
        if fault is not Fault.TRACKER_DUPLICATE:
            self._watch.refused(frame.pieces[-1].t_ns, frame.skipped)

    def _time_of_validity(
        self, frame: Frame, solution: AttitudeDatagram, restart: bool
    ) -> tuple[int, float]:
        """Return the time of validity and the solution's lateness against the clock model [ns]."""
        arrivals, clock, n = self._arrivals, self._clock, solution.unix_us
        if arrivals.is_new_chunk(frame):
            for done in arrivals.finish(frame):
                bound_ns = done.bound_ns(arrivals.bytes_in_chunk, arrivals.byte_ns)
                clock.observe(done.n, done.t_receive_ns, bound_ns - done.delay_ns)
        if restart:
            clock.reset()
            arrivals.clear()
        by_unit = self._config.time == "unit"
        # timed by arrival, the latency extends to the last byte of a frame without escapes
        length = len(frame.data) if by_unit else len(frame.data) - self._codec.frame_bytes[0]
        delay_ns = length * arrivals.byte_ns
        arrival = arrivals.add(frame, n, delay_ns)
        sent_ns = arrival.bound_ns(arrival.bytes_before, arrivals.byte_ns) - delay_ns
        late_ns = 0.0
        if clock.ready:
            reference_ns, rest_ns = clock.predict_ns(n)
            predicted_ns = (reference_ns - arrival.t_receive_ns) + rest_ns
            late_ns = sent_ns - predicted_ns
            if by_unit:
                sent_ns = min(sent_ns, predicted_ns)
        return arrival.t_receive_ns + round(sent_ns - self._latency_ns), late_ns

    def _is_next(self, unix_us: int, t_ns: int, frame: bytes) -> bool:
        if self._last is None:
            return True
        if unix_us == self._last[0]:  # a unit whose time is not set, or the same frame again
            return unix_us == 0 and frame != self._last_frame
        least_ns = PERIOD_RATIO * self._period_ns
        if self._clock.ready:
            ahead_ns = self._clock.early_ns(unix_us, t_ns)
        else:
            ahead_ns = (unix_us - self._last[0]) * 1e3 - (t_ns - self._last[1])
        return ahead_ns <= least_ns and self._follows((unix_us, t_ns), self._last, least_ns)

    def _is_chain(self, unix_us: int, t_ns: int) -> bool:
        now = (unix_us, t_ns)
        in_order = self._chain and self._doubted is not None and self._follows(now, self._doubted)
        self._chain = self._chain + 1 if in_order else 1
        self._doubted = now
        return self._chain >= CHAIN

    def _count_lost(self, unix_us: int, t_ns: int) -> int:
        """Count and return lost solutions, by unit time, or by arrival if unit time is not set."""
        if self._last is None:
            return 0
        elapsed_s = (unix_us - self._last[0]) * 1e-6
        if not unix_us or not self._last[0]:
            elapsed_s = (t_ns - self._last[1]) * 1e-9
        periods = round(elapsed_s * self._config.rate_hz)
        lost = max(0, periods - 1)
        self._counts.lost += lost
        return lost

    def _follows(
        self, now: tuple[int, int], before: tuple[int, int], least_ns: float = 0.0
    ) -> bool:
        """Return whether unit time advanced by more than `least_ns`, about as host time did."""
        unit_ns, host_ns = (now[0] - before[0]) * 1e3, now[1] - before[1]
        return unit_ns > least_ns and abs(unit_ns - host_ns) < JUMP_NS + self._waited_ns
