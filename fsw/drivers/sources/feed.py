"""A live feed: datagrams of another program to samples of joints, inertial unit, star tracker.

Every kind of datagram has its own sequence, clock model, counters and watch; datagrams that belong
to none of them count for the first kind. Joints are judged as those on a CAN bus are.
"""

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fsw.config import BusConfig, Config, HealthConfig
from fsw.config.feed import SAMPLES
from fsw.config.keys import read_key
from fsw.drivers.codecs.feed import Datagram, Kind, decode_datagram
from fsw.drivers.sources.counters import Counters
from fsw.drivers.sources.joint_end import JointEnd, Raw
from fsw.drivers.sources.line_watch import IMU_LINE, TRACKER_LINE, LineFaults, LineWatch
from fsw.drivers.sources.samples import (
    SampleSource,
    attitude_samples,
    imu_samples,
)
from fsw.drivers.sources.sender import Order, SenderTrack, Timed
from fsw.drivers.wire import ByteChunk, Reject
from fsw.errors import ConfigError
from fsw.messages import IntArray, JointSamples, Samples
from fsw.messages.findings import Fault, Finding

SILENT_S = 0.1  # a program on a machine with others may pause for a shorter time
LATE_S = 0.02  # ... and a datagram may wait for this long
MAX_FINDINGS = 1024  # kept until `findings`; the oldest are discarded
FEED_LINE = LineFaults(
    Fault.BUS_SILENT,
    Fault.JOINT_LOST,
    Fault.JOINT_LENGTH,
    Fault.JOINT_LENGTH,
    Fault.NODE_UNKNOWN,
    Fault.JOINT_DUPLICATE,
    Fault.JOINT_ORDER,
    Fault.JOINT_COUNTER,
    Fault.JOINT_LATE,
    Fault.NODE_RESTARTED,
)
_FAULTS = {Kind.JOINTS: FEED_LINE, Kind.IMU: IMU_LINE, Kind.ATTITUDE: TRACKER_LINE}


@dataclass(slots=True)
class _Stream:
    """The datagrams of one kind."""

    name: str
    faults: LineFaults
    widths: tuple[int, ...]  # possible numbers of values
    track: SenderTrack
    watch: LineWatch
    per_datagram: int  # samples in a datagram
    counts: Counters = field(default_factory=Counters)
    rows: list[tuple[Timed, int, tuple[float, ...]]] = field(default_factory=list)

    def count_refused(self, reason: Reject, count: int) -> None:
        """Count samples of accepted datagrams that are not used."""
        self.counts.rejected += count
        self.counts.rejects[reason] += count
        self.counts.accepted -= count

    def take(self) -> tuple[IntArray, IntArray, IntArray, list[tuple[float, ...]]]:
        """Return index, time of validity, receive stamp (k,) and values of the accepted rows."""
        rows, self.rows = self.rows, []
        times = [(timed.index, timed.t_valid_ns, t_ns) for timed, t_ns, _ in rows]
        index, t_valid_ns, t_receive_ns = np.array(times, np.int64).reshape(-1, 3).T.copy()
        return index, t_valid_ns, t_receive_ns, [values for _, _, values in rows]


class FeedSource:
    """Every device of one feed.

    Raises
    ------
    ConfigError when the key of the feed cannot be read.
    """

    def __init__(self, config: Config, bus: BusConfig) -> None:
        if bus.feed is None:
            raise ConfigError(f"buses: {bus.name!r} has no feed")
        self._feed = bus.feed
        key_file = bus.feed.key_file
        self._key = None if key_file is None else read_key(config.resolve(key_file))
        self._name = bus.name
        self._streams: dict[Kind, _Stream] = {}
        self._found: deque[Finding] = deque(maxlen=MAX_FINDINGS)
        joints = [(i, joint) for i, joint in enumerate(config.joints) if joint.bus == bus.name]
        self._joints = _Joints(joints, bus) if joints else None
        self._others: dict[Kind, SampleSource] = {}
        health = config.health
        if joints:
            n = len(joints)
            self._add(Kind.JOINTS, bus.name, (2 * n, 3 * n), n, bus.rate_hz, health)
        if config.imu.driver == SAMPLES and config.imu.bus == bus.name:
            self._others[Kind.IMU] = imu_samples(config.imu)
            self._add(Kind.IMU, "imu", (6,), 1, config.imu.rate_hz, health)
        tracker = config.star_tracker
        if tracker is not None and tracker.driver == SAMPLES and tracker.bus == bus.name:
            self._others[Kind.ATTITUDE] = attitude_samples(tracker)
            self._add(Kind.ATTITUDE, "star_tracker", (4,), 1, tracker.rate_hz, health)

    def _add(
        self,
        kind: Kind,
        name: str,
        widths: tuple[int, ...],
        per_datagram: int,
        rate_hz: float,
        health: HealthConfig,
    ) -> None:
        faults = _FAULTS[kind]
        silent_periods = max(health.silent_periods, SILENT_S * rate_hz)
        watch = LineWatch(faults, name, 1e9 / rate_hz, silent_periods)
        track = SenderTrack(self._feed, rate_hz)
        self._streams[kind] = _Stream(name, faults, widths, track, watch, per_datagram)

    @property
    def counters(self) -> dict[str, dict[str, int]]:
        """Counters of samples and bytes, by name of the feed or device."""
        return {stream.name: stream.counts.as_dict() for stream in self._streams.values()}

    def findings(self) -> list[Finding]:
        """Return the findings since the last call."""
        found = [*self._found]
        self._found.clear()
        for stream in self._streams.values():
            found += stream.watch.take()
        return found

    def watch(self, now_ns: int, *, up: bool) -> None:
        """Find out whether the sender is silent; call this after feeding all that was received."""
        for stream in self._streams.values():
            stream.watch.watch(now_ns, up=up)

    def feed(self, chunks: Sequence[ByteChunk]) -> list[Samples]:
        """Accept datagrams in order, one in each chunk, and return their samples by kind."""
        for chunk in chunks:
            self._accept(chunk)
        found: list[Samples] = []
        for kind, stream in self._streams.items():
            if not stream.rows:
                continue
            if kind is Kind.JOINTS and self._joints is not None:
                found.append(self._joints.samples(stream, self._found))
            else:
                found.append(_values(stream, self._others[kind]))
        return found

    def _accept(self, chunk: ByteChunk) -> None:
        """Judge one datagram and keep its values."""
        t_ns, length = chunk.t_ns, len(chunk.data)
        item = decode_datagram(chunk.data, self._key)
        stream, reason, words = self._owner(item)
        stream.counts.received_bytes += length
        if isinstance(item, Reject) or reason is not None:
            stream.counts.reject(reason or Reject.LENGTH, length)
            is_damaged = reason is Reject.LENGTH
            faults = stream.faults
            fault = faults.damaged if is_damaged else faults.noise
            stream.watch.find(t_ns, faults.clock if reason is Reject.STALE else fault, words)
            return
        order = stream.track.judge(item, t_ns)
        if order.reason is not None:
            stream.counts.reject(order.reason, length)
            self._doubt(stream, order, item, t_ns)
            return
        timed = stream.track.accept(item, t_ns, order)
        stream.watch.accepted(t_ns, 0, timed.lost, length)
        stream.counts.lost += timed.lost * stream.per_datagram
        stream.counts.accepted += stream.per_datagram
        stream.counts.accepted_bytes += length
        if order is Order.RESTART:
            text = f"{order.value} with sequence {item.sequence}"
            stream.watch.find(t_ns, stream.faults.restarted, text)
        if timed.late_ns > LATE_S * 1e9:
            text = f"{timed.late_ns * 1e-6:.0f} ms after it was sent"
            stream.watch.find(t_ns, stream.faults.late, text)
        stream.rows.append((timed, t_ns, item.values))

    def _owner(self, item: Datagram | Reject) -> tuple[_Stream, Reject | None, str]:
        """Return the stream for which a datagram counts, and why it is refused: reason, words."""
        first = next(iter(self._streams.values()))
        if isinstance(item, Reject):
            return first, item, f"no datagram of this feed: {item.value}"
        if item.source != self._feed.source:
            return first, Reject.NODE, f"source {item.source}, not {self._feed.source}"
        stream = self._streams.get(item.kind)
        if stream is None:
            return first, Reject.NODE, f"kind {item.kind.name.lower()}, which is not configured"
        if item.clock != self._feed.clock:
            return stream, Reject.STALE, f"times of clock {item.clock}, not {self._feed.clock}"
        if len(item.values) not in stream.widths:
            numbers = " or ".join(map(str, stream.widths))
            return stream, Reject.LENGTH, f"{len(item.values)} values, not {numbers}"
        return stream, None, ""

    def _doubt(self, stream: _Stream, order: Order, item: Datagram, t_ns: int) -> None:
        """Report a datagram that is not the next one."""
        faults = stream.faults
        fault = {Order.DOUBLED: faults.doubled, Order.OLD: faults.order}.get(order, faults.clock)
        stream.watch.find(t_ns, fault, f"sequence {item.sequence}: {order.value}")
        if order is Order.UNTIMED:
            stream.watch.refused(t_ns, 0)


def _values(stream: _Stream, source: SampleSource) -> Samples:
    """Return the samples of the inertial unit or the star tracker."""
    _, t_ns, t_receive_ns, values = stream.take()
    found = source.build(t_ns, t_receive_ns, np.array(values, np.float64))
    stream.count_refused(Reject.RANGE, len(values) - len(found))
    return found


class _Joints:
    """Values of a feed's joints to calibrated and judged samples."""

    def __init__(self, joints: Sequence[tuple[int, Any]], bus: BusConfig) -> None:
        self._speed_only = np.array([joint.speed_only for _, joint in joints])
        self._n = len(joints)
        offset_ns = round(bus.latch_offset_s * 1e9)
        self._end = JointEnd(joints, 1.0 / bus.rate_hz, offset_ns=offset_ns)

    def samples(self, stream: _Stream, found: deque[Finding]) -> JointSamples:
        """Return the good samples of the accepted datagrams; add findings to `found`."""
        n = self._n
        index, t_ns, t_receive_ns, rows = stream.take()
        values = np.full((len(rows), 3, n), np.nan)
        for k, row in enumerate(rows):
            values[k, : len(row) // n] = np.reshape(row, (-1, n))
        raw = np.where(self._speed_only, values[:, 2], values[:, 0])
        joint = np.tile(np.arange(n), len(rows))
        index, t_ns, t_receive_ns = (np.repeat(one, n) for one in (index, t_ns, t_receive_ns))
        usable = np.isfinite(raw.ravel())
        self._report(joint, t_receive_ns, np.flatnonzero(~usable), Fault.ENCODER_FAULT, found)
        stream.count_refused(Reject.STATUS, int(np.count_nonzero(~usable)))
        own = Raw(joint, index, t_ns, t_receive_ns, raw.ravel(), values[:, 1].ravel())
        judged = self._end.judge(own, usable)
        self._report(joint, t_receive_ns, judged.silent, Fault.TORQUE_FAULT, found)
        for k, reason, fault in judged.refused:
            stream.count_refused(reason, 1)
            if fault is not None:
                name = self._end.tracks[joint[k]].config.name
                found.append(Finding(int(t_receive_ns[k]), fault, name))
        return judged.samples

    def _report(
        self,
        joint: IntArray,
        t_ns: IntArray,
        rows: Iterable[int],
        fault: Fault,
        found: deque[Finding],
    ) -> None:
        """Add a finding for each value that the sender has marked as not valid."""
        for row in rows:
            name = self._end.tracks[joint[row]].config.name
            found.append(Finding(int(t_ns[row]), fault, name, "not valid by the sender's mask"))
