"""Inertial unit: serial chunks to samples with their times of validity."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fsw.config import HealthConfig, ImuConfig
from fsw.config.constants import STANDARD_GRAVITY_M_S2
from fsw.drivers.codecs.entries import imu_codec
from fsw.drivers.codecs.framing import Frame
from fsw.drivers.codecs.imu_datagram import (
    ImuCodec,
    ImuDatagram,
    ImuRun,
    Vector3,
)
from fsw.drivers.sources.arrival import Arrival, ArrivalTracker
from fsw.drivers.sources.clock_model import ClockModel
from fsw.drivers.sources.counters import Counters, serial_counters
from fsw.drivers.sources.line_watch import IMU_LINE, LineWatch
from fsw.drivers.sources.samples import calibrated
from fsw.drivers.sources.sequence import Counted, CounterTrack, Step
from fsw.drivers.wire import ByteChunk, Reject
from fsw.messages import FloatArray, ImuSamples, IntArray, joined
from fsw.messages.findings import Fault, Finding

SUBJECT = "imu"
MIN_LATENCY_LIMIT_S = 0.01  # a latency above this and above two periods is invalid
JITTER_SAMPLES, JITTER_OF = 3, 16  # this many late samples of this many are jitter
IRREGULAR_CHUNKS = 16  # chunks judged one by one before the next search for a run
UNUSABLE: Vector3 = (math.nan, math.nan, math.nan)
NO_SAMPLES = ImuSamples(*np.empty((3, 0), np.int64), *np.empty((2, 0, 3)))
_Sample = tuple[tuple[int, int, int], Vector3, Vector3]  # times [ns], rate, specific force
_REFUSED = {Step.WRONG: Reject.SEQUENCE, Step.UNTRUE: Reject.RANGE}


class ImuSource:
    """One inertial unit.

    The unit's counter gives a sample its time, not the arrival. A clock model maps device time to
    host time; it is fitted under all arrivals minus latency and serialisation time. A sample's
    time uses the chunks before the one with its last byte, and of that chunk only the bound of the
    sample itself. So the time is known at once and does not depend on junk.
    """

    def __init__(
        self,
        config: ImuConfig,
        codec: ImuCodec | None = None,
        health: HealthConfig | None = None,
    ) -> None:
        health = health or HealthConfig()
        if codec is None:
            codec = imu_codec(config)
        self._codec = codec
        self._arrivals = ArrivalTracker(config.baud_rate)
        self._clock = ClockModel(codec.tick_s, config.clock_tolerance_ppm)
        step = 1.0 / (codec.tick_s * config.rate_hz)
        self._track = CounterTrack(codec.modulus, codec.tick_s, step)
        self._counts = Counters()
        self._rate_limit = config.max_rate_rad_s
        self._force_limit = config.acc_range_g * STANDARD_GRAVITY_M_S2
        self._period_s = 1.0 / config.rate_hz
        self._latency_limit_s = max(MIN_LATENCY_LIMIT_S, 2.0 / config.rate_hz)
        self._gyro_delay_ns = config.gyro_group_delay_s * 1e9
        self._acc_delay_ns = config.acc_group_delay_s * 1e9
        self._config = config
        self._group: list[tuple[Arrival, ImuDatagram]] = []
        self._watch = LineWatch(IMU_LINE, SUBJECT, 1e9 / config.rate_hz, health.silent_periods)
        self._jitter_ns = health.jitter_s * 1e9
        self._late = 0  # bit i: the i-th newest sample was late
        self._has_rate = self._has_force = False  # whether any sample had usable ones

    @property
    def counters(self) -> dict[str, int]:
        """Counters of samples and bytes."""
        self._counts.lost = self._track.lost
        return serial_counters(self._counts, self._codec.framer)

    @property
    def clock_rate_error_ppm(self) -> float:
        """Fitted rate error of the unit's clock."""
        return self._clock.rate_error_ppm

    def lacks(self) -> str:
        """Return in words which data the unit has never sent in usable form; empty: none."""
        if (words := self._codec.lacks()) or not self._counts.accepted:
            return words
        given = {"rates": self._has_rate, "accelerations": self._has_force}
        missing = " and ".join(name for name, is_given in given.items() if not is_given)
        return f"no usable {missing} in any datagram" if missing else ""

    def findings(self) -> list[Finding]:
        """Return the findings since the last call."""
        return self._watch.take()

    def watch(self, now_ns: int, *, up: bool) -> None:
        """Find out whether the unit is silent; call this after feeding all that was received."""
        self._watch.watch(now_ns, up=up, words=self._codec.lacks())

    def feed(self, chunks: Sequence[ByteChunk]) -> ImuSamples:
        """Accept chunks in order and return the samples they complete."""
        parts: list[ImuSamples] = []
        while chunks:
            run = self._codec.run(chunks)
            found = None if run is None else self._follow(run)
            if run is not None and found is not None:
                parts.append(found)
                chunks = chunks[len(run.chunks) :]
            else:
                parts.append(self._one_by_one(chunks[:IRREGULAR_CHUNKS]))
                chunks = chunks[IRREGULAR_CHUNKS:]
        return calibrated(self._config, joined(parts) if parts else NO_SAMPLES)

    def _follow(self, run: ImuRun) -> ImuSamples | None:
        """Accept a run of datagrams without a gap; else return None and change nothing.

        Every datagram lies in one chunk, whose bytes are all accepted, so this chunk alone bounds
        the datagram's arrival.
        """
        counts = [len(chunk.data) // run.length for chunk in run.chunks]
        t_ns = np.repeat(np.array([chunk.t_ns for chunk in run.chunks], np.int64), counts)
        w, f = run.w_NS_S_rad_s, run.f_NS_S_m_s2
        if not self._watch.is_clean or not self._clock.ready:
            return None
        if np.abs(w).max() > self._rate_limit or np.abs(f).max() > self._force_limit:
            return None
        if run.latency_s.max() > self._latency_limit_s:
            return None
        latency_ns = run.latency_s * 1e9
        indexes = self._track.follow(run.counter, t_ns, latency_ns)
        if indexes is None:
            return None
        arrivals = self._arrivals
        first = self._codec.framer.pass_over(run.chunks)
        self._observe(arrivals.finish_whole())
        # per datagram: datagrams in earlier chunks, its end in its chunk [bytes], its chunk's size
        numbers = np.array(counts)
        before = np.repeat(np.cumsum(numbers) - numbers, counts)
        ends = (np.arange(len(w)) - before + 1) * run.length
        sizes = np.repeat(numbers, counts) * run.length
        delays_ns = latency_ns + run.length * arrivals.byte_ns
        sent_ns = np.minimum(0.0, (ends - sizes) * arrivals.byte_ns) - delays_ns
        last = len(w) - counts[-1]  # datagrams of the last chunk are not final
        predicted_ns = self._clock.follow(indexes, t_ns[:last], sent_ns[:last], before)
        predicted_ns += self._clock.reference_ns - t_ns
        self._look_at_all(sent_ns - predicted_ns, t_ns)
        sent_ns = np.minimum(sent_ns, predicted_ns)
        arrivals.add_whole(first + len(counts) - 1, counts[-1], run.length)
        held = zip(indexes[last:].tolist(), delays_ns[last:].tolist(), strict=True)
        arrivals.hold(
            [
                Arrival(n, delay_ns, run.chunks[-1].t_ns, 0.0, (place + 1) * run.length)
                for place, (n, delay_ns) in enumerate(held)
            ]
        )
        self._watch.followed(run.chunks[-1].t_ns)
        self._counts.accepted += len(w)
        self._counts.accepted_bytes += len(w) * run.length
        self._has_rate = self._has_force = True
        return ImuSamples(
            t_ns + np.rint(sent_ns - self._gyro_delay_ns).astype(np.int64),
            t_ns + np.rint(sent_ns - self._acc_delay_ns).astype(np.int64),
            t_ns,
            w,
            f,
        )

    def _observe(self, done: list[Arrival]) -> None:
        """Give final arrivals to the clock model."""
        arrivals = self._arrivals
        for arrival in done:
            bound_ns = arrival.bound_ns(arrivals.bytes_in_chunk, arrivals.byte_ns)
            self._clock.observe(arrival.n, arrival.t_receive_ns, bound_ns - arrival.delay_ns)

    def _sent_ns(self, arrival: Arrival) -> float:
        """Return when a datagram's first byte was sent, relative to its chunk's stamp [ns]."""
        arrivals, base_ns = self._arrivals, arrival.t_receive_ns
        sent_ns = arrival.bound_ns(arrivals.bytes_in_chunk, arrivals.byte_ns) - arrival.delay_ns
        if self._clock.ready:
            reference_ns, rest_ns = self._clock.predict_ns(arrival.n)
            predicted_ns = (reference_ns - base_ns) + rest_ns
            self._look_at_lateness(sent_ns - predicted_ns, base_ns)
            sent_ns = min(sent_ns, predicted_ns)
        return sent_ns

    def _one_by_one(self, chunks: Sequence[ByteChunk]) -> ImuSamples:
        """Accept chunks of any content and return the samples they complete."""
        samples: list[_Sample] = []
        for chunk in chunks:
            frames = self._codec.framer.feed(chunk)
            if frames:
                self._take(self._plausible(frames), samples)
        if not samples:
            return NO_SAMPLES
        times_ns, rates, forces = zip(*samples, strict=True)
        gyro_ns, acc_ns, receive_ns = np.array(times_ns, np.int64).T.copy()
        return ImuSamples(gyro_ns, acc_ns, receive_ns, np.array(rates), np.array(forces))

    def _plausible(self, frames: list[Frame]) -> list[tuple[Frame, ImuDatagram]]:
        """Decode frames and reject those whose values no working unit sends."""
        good = []
        for frame in frames:
            datagram = self._codec.decode(frame)
            if datagram is None:
                self._counts.accepted_bytes += len(frame.data)
            elif isinstance(datagram, Reject):
                self._counts.reject(datagram, len(frame.data))
                if datagram is not Reject.STALE:  # a stale one is not counted as a sample
                    self._watch.refused(frame.pieces[-1].t_ns, frame.skipped)
            elif self._is_in_range(datagram):
                good.append((frame, datagram))
            else:
                self._counts.reject(Reject.RANGE, len(frame.data))
                self._watch.refused(frame.pieces[-1].t_ns, frame.skipped)
                self._watch.find(frame.pieces[-1].t_ns, Fault.IMU_RANGE)
        return good

    def _is_in_range(self, datagram: ImuDatagram) -> bool:
        gyro_s, acc_s = (
            self._period_s if interval_s is None else 1.0  # of an increment
            for interval_s in (datagram.gyro_interval_s, datagram.acc_interval_s)
        )
        return (
            _is_below(datagram.w_NS_S_rad_s, self._rate_limit * gyro_s)
            and _is_below(datagram.f_NS_S_m_s2, self._force_limit * acc_s)
            and datagram.latency_s <= self._latency_limit_s
        )

    def _take(self, items: list[tuple[Frame, ImuDatagram]], samples: list[_Sample]) -> None:
        track, arrivals, clock = self._track, self._arrivals, self._clock
        for at, (frame, datagram) in enumerate(items):
            length = len(frame.data)
            chunk, t_ns = frame.pieces[-1].chunk, frame.pieces[-1].t_ns
            queued = 1
            while at + queued < len(items) and items[at + queued][0].pieces[-1].chunk == chunk:
                queued += 1
            latency_ns = datagram.latency_s * 1e9
            delay_ns = latency_ns + length * arrivals.byte_ns
            counted = Counted(datagram.counter, t_ns, t_ns - delay_ns, queued, latency_ns)
            step = track.check(counted, clock)
            if step in _REFUSED:
                self._counts.reject(_REFUSED[step], length)
                self._doubt(step, frame, datagram.counter)
                continue
            if arrivals.is_new_chunk(frame):
                self._release(samples)
                self._observe(arrivals.finish(frame))
            if step is Step.RESTART:
                self._release(samples)
                clock.reset()
                arrivals.clear()
            lost = track.lost
            n = track.accept(counted, clock, step)
            lost = 0 if step is Step.RESTART else track.lost - lost
            self._watch.accepted(t_ns, frame.skipped, lost, length)
            self._look_at_status(datagram, t_ns)
            self._counts.accepted += 1
            self._counts.accepted_bytes += length
            step_s = track.interval * self._codec.tick_s
            self._group.append((arrivals.add(frame, n, delay_ns), _in_rates(datagram, step_s)))
        self._release(samples)

    def _doubt(self, step: Step, frame: Frame, counter: int) -> None:
        t_ns = frame.pieces[-1].t_ns
        if self._track.is_repeated(counter):
            self._watch.find(t_ns, Fault.IMU_DUPLICATE)
            return  # a repeated datagram replaces no missing sample
        self._watch.refused(t_ns, frame.skipped)
        fault = Fault.IMU_LATENCY if step is Step.UNTRUE else Fault.IMU_COUNTER
        self._watch.find(t_ns, fault, f"counter {counter}")

    def _look_at_status(self, datagram: ImuDatagram, t_ns: int) -> None:
        """Report clusters that their status makes unusable."""
        gyro, acc = datagram.gyro_status, datagram.acc_status
        if not gyro | acc:
            return
        if (gyro | acc) & self._codec.start_up_bits:
            self._watch.find(t_ns, Fault.IMU_START_UP)
            return
        for status, value, overload, fault in (
            (gyro, datagram.w_NS_S_rad_s, Fault.GYRO_OVERLOAD, Fault.GYRO_FAULT),
            (acc, datagram.f_NS_S_m_s2, Fault.ACC_OVERLOAD, Fault.ACC_FAULT),
        ):
            if status and value is None:
                found = overload if status & self._codec.overload_bits else fault
                self._watch.find(t_ns, found, f"status 0x{status:02x}")

    def _look_at_all(self, late_ns: FloatArray, t_ns: IntArray) -> None:
        """Judge the lateness of samples (k,) in order."""
        if np.count_nonzero(late_ns > self._jitter_ns):
            for late, time_ns in zip(late_ns.tolist(), t_ns.tolist(), strict=True):
                self._look_at_lateness(late, time_ns)
        else:
            self._late = self._late << len(late_ns) & (1 << JITTER_OF) - 1

    def _look_at_lateness(self, late_ns: float, t_ns: int) -> None:
        late = late_ns > self._jitter_ns
        self._late = (self._late << 1 | late) & (1 << JITTER_OF) - 1
        if late and self._late.bit_count() >= JITTER_SAMPLES:
            text = f"{late_ns * 1e-6:.1f} ms later than the unit's clock allows"
            self._watch.find(t_ns, Fault.IMU_JITTER, text)

    def _release(self, samples: list[_Sample]) -> None:
        """Give the accepted datagrams of one chunk their times and add them to the samples."""
        for arrival, datagram in self._group:
            base_ns, sent_ns = arrival.t_receive_ns, self._sent_ns(arrival)
            times_ns = (
                base_ns
                + round(sent_ns - self._gyro_delay_ns - _middle_ns(datagram.gyro_interval_s)),
                base_ns + round(sent_ns - self._acc_delay_ns - _middle_ns(datagram.acc_interval_s)),
                base_ns,
            )
            rate, force = datagram.w_NS_S_rad_s, datagram.f_NS_S_m_s2
            self._has_rate |= rate is not None
            self._has_force |= force is not None
            samples.append(
                (times_ns, UNUSABLE if rate is None else rate, UNUSABLE if force is None else force)
            )
        self._group = []


def _is_below(vector: Vector3 | None, limit: float) -> bool:
    if vector is None:
        return True
    x, y, z = vector
    return -limit <= x <= limit and -limit <= y <= limit and -limit <= z <= limit


def _middle_ns(interval_s: float | None) -> float:
    """Return half of the interval of a mean value [ns]: it is valid in the interval's middle."""
    return 0.0 if interval_s is None else 5e8 * interval_s


def _in_rates(datagram: ImuDatagram, step_s: float) -> ImuDatagram:
    """Return a datagram with its increments divided by the time of a step of the device."""
    if datagram.gyro_interval_s is None:
        w = _over(datagram.w_NS_S_rad_s, step_s)
        datagram = replace(datagram, w_NS_S_rad_s=w, gyro_interval_s=step_s)
    if datagram.acc_interval_s is None:
        f = _over(datagram.f_NS_S_m_s2, step_s)
        datagram = replace(datagram, f_NS_S_m_s2=f, acc_interval_s=step_s)
    return datagram


def _over(increment: Vector3 | None, step_s: float) -> Vector3 | None:
    if increment is None:
        return None
    x, y, z = increment
    return (x / step_s, y / step_s, z / step_s)
