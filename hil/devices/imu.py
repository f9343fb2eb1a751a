"""The simulated inertial unit: samples on its own clock, datagrams on a serial line."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hil.devices.imu_wire import Batch, wire_of
from hil.devices.truth_clock import ClampedHistory, TruthClock
from hil.devices.uart import SerialLine, TimedBytes
from hil.world.sensor_config import ImuSensorConfig
from hil.world.sensors import ImuErrors, angular_rate, generator, rotation_of, specific_force

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BATCH = 128
BATCH_S = 0.25


class Imu:
    """Inertial unit that samples on its own clock and sends `latency_s` after each sample.

    Datagram n holds the rate at the sample instant minus the gyro's group delay, and the specific
    force at the sample instant minus the accelerometer's. A cluster that averages holds the mean of
    the period before this instant. `truth_ns` returns both times of validity exactly.
    """

    def __init__(
        self,
        config: ImuSensorConfig,
        history: ClampedHistory,
        clock: TruthClock,
        seed: int,
        t0_ns: int,
    ) -> None:
        self._wire = wire_of(config)
        rng = generator(seed, "imu", 0, 3)
        self.clock_error_ppm = float(rng.uniform(-1.0, 1.0)) * config.clock_error_ppm
        self._period_ns = 1e9 / config.rate_hz * (1.0 + 1e-6 * self.clock_error_ppm)
        self._t0_ns = t0_ns + float(rng.uniform(0.0, 1.0)) * self._period_ns
        self._counter0 = int(rng.integers(0, 256))
        self._jitter = generator(seed, "imu", 0, 4)
        self.errors = ImuErrors(config, seed)
        self._config, self._history, self._clock = config, history, clock
        self._R_BS = rotation_of(config.q_BS_xyzw)
        self._gyro_reads = np.linalg.solve(np.array(config.gyro_matrix), np.eye(3)).T
        self.line = SerialLine(
            config.baud_rate,
            config.chunking,
            generator(seed, "line", 0),
            t0_ns,
            config.chunk_clock_ppm,
        )
        self._next = 0
        seconds = min(BATCH_S, clock.start_delay_s)
        self._batch = max(1, min(BATCH, int(seconds * config.rate_hz)))
        length = self._wire.length
        budget_s = 1.0 / config.rate_hz - config.latency_jitter_s
        if length * 10 / config.baud_rate >= budget_s:
            raise ValueError(
                f"sensors.imu.baud_rate: too slow, {length} bytes exceed a period of the unit "
                f"(value: {config.baud_rate})"
            )

    def sample_ns(self, n: IntArray) -> IntArray:
        """Return the sample instants of datagrams n on the host's clock [ns]."""
        instants: IntArray = np.rint(self._t0_ns + n * self._period_ns).astype(np.int64)
        return instants

    def truth_ns(self, n: IntArray) -> tuple[IntArray, IntArray]:
        """Return the true times of validity [ns] of datagrams n: gyro, accelerometer."""
        config, sample = self._config, self.sample_ns(n)
        delays_s = (config.gyro_group_delay_s, config.acc_group_delay_s)
        gyro_ns, acc_ns = (
            round(delay_s * 1e9 + 0.5 * averages * self._period_ns)
            for delay_s, averages in zip(delays_s, self._wire.averages, strict=True)
        )
        return sample - gyro_ns, sample - acc_ns

    def times(self) -> dict[str, float]:
        """Return the sampling clock, and by how much a rate is older than its sample instant."""
        gyro_ns, _ = self.truth_ns(np.array([0]))
        return {
            "t0_ns": self._t0_ns,
            "period_ns": self._period_ns,
            "gyro_delay_ns": int(self.sample_ns(np.array([0]))[0] - gyro_ns[0]),
            "counter0": self._counter0,
            "clock_error_ppm": self.clock_error_ppm,
        }

    def next_ns(self) -> int:
        """Return the time when the host receives the next chunk [ns]."""
        while True:
            due = self.line.next_ns()
            if due is not None:
                return due
            self._generate()

    def take(self, until_ns: int) -> list[TimedBytes]:
        """Return the chunks that the host has received by this time, with their times."""
        while self._first_possible_ns() <= until_ns:
            self._generate()
        return self.line.take(until_ns)

    def _first_possible_ns(self) -> int:
        """Return a time before which no further datagram can start."""
        earliest = self._t0_ns + self._next * self._period_ns + self._config.latency_s * 1e9
        return int(earliest) - 1000

    def _generate(self) -> None:
        """Encode one batch of datagrams and send the batch on the line."""
        config = self._config
        n = np.arange(self._next, self._next + self._batch)
        self._next += self._batch
        gyro_ns, acc_ns = self.truth_ns(n)
        sample_ns = self.sample_ns(n)
        errors = self.errors.next(len(n))
        jitter_s = config.latency_jitter_s * self._jitter.random(len(n))
        latency_us = np.rint((config.latency_s + jitter_s) * 1e6).astype(np.int64)
        rate, force = self._measured(gyro_ns, acc_ns)
        batch = Batch(
            number=n,
            counter0=self._counter0,
            period_s=1.0 / config.rate_hz,
            w_NS_S_rad_s=rate @ self._gyro_reads + errors[:, :3],
            f_NS_S_m_s2=force + errors[:, 3:],
            latency_us=latency_us,
            starting=n < config.startup_s * config.rate_hz,
        )
        self.line.send((sample_ns + latency_us * 1000).tolist(), self._wire.encode(batch))
        self.line.complete(self._first_possible_ns())

    def _measured(self, gyro_ns: IntArray, acc_ns: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return rates and specific forces (k, 3) valid at these times, means where averaged."""
        config, half_ns = self._config, round(0.5 * self._period_ns)

        def rate(t_ns: IntArray) -> FloatArray:
            return angular_rate(self._history.at(self._clock.seconds(t_ns)), self._R_BS)

        def force(t_ns: IntArray) -> FloatArray:
            state = self._history.at(self._clock.seconds(t_ns))
            return specific_force(state, config.p_BS_m, self._R_BS, config.acceleration)

        def mean(of: Callable[[IntArray], FloatArray], t_ns: IntArray) -> FloatArray:
            """Return the mean over the period around the times, by Simpson's rule."""
            sides = of(t_ns - half_ns) + of(t_ns + half_ns)
            return np.asarray((sides + 4.0 * of(t_ns)) / 6.0)

        averages = self._wire.averages
        return (
            mean(rate, gyro_ns) if averages[0] else rate(gyro_ns),
            mean(force, acc_ns) if averages[1] else force(acc_ns),
        )
