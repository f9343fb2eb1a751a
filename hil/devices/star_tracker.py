"""The simulated star tracker: exposures on its own clock, solutions and answers on a line."""

import numpy as np
from numpy.typing import NDArray

from hil.devices import sagitta
from hil.devices.truth_clock import ClampedHistory, TruthClock
from hil.devices.uart import SerialLine, TimedBytes
from hil.world.sensor_config import StarTrackerSensorConfig
from hil.world.sensors import NormalStream, attitude, generator

IntArray = NDArray[np.int64]
ANSWER_NS = 1_000_000  # from request to first byte of the answer


class StarTracker:
    """Star tracker: exposure k is at t0 + k/rate, its frame ends `latency_s` later.

    Escaped bytes make the frame end later. A fault may set `valid` to False.
    """

    def __init__(
        self,
        config: StarTrackerSensorConfig,
        history: ClampedHistory,
        clock: TruthClock,
        seed: int,
        t0_ns: int,
    ) -> None:
        rng = generator(seed, "star_tracker", 0, 1)
        error_ppm = float(rng.uniform(-1.0, 1.0)) * config.clock_error_ppm
        self._period_ns = 1e9 / config.rate_hz * (1.0 + 1e-6 * error_ppm)
        self._t0_ns = t0_ns + float(rng.uniform(0.0, 1.0)) * self._period_ns
        self._power_on_ns = t0_ns
        self._noise = NormalStream(generator(seed, "star_tracker", 0, 0), 3)
        self._jitter = generator(seed, "star_tracker", 0, 2)
        self._config, self._history, self._clock = config, history, clock
        self.line = SerialLine(
            config.baud_rate,
            config.chunking,
            generator(seed, "line", 1),
            t0_ns,
            config.chunk_clock_ppm,
        )
        self._requests = sagitta.RequestReader()
        self.subscribed = config.subscribed
        self.valid = True
        self._next = 0
        self._frame_start_ns = self._start_of_next()

    def truth_ns(self, k: IntArray) -> IntArray:
        """Return the mid-exposure times of solutions k on the host's clock [ns]."""
        instants: IntArray = np.rint(self._t0_ns + k * self._period_ns).astype(np.int64)
        return instants

    def _start_of_next(self) -> int:
        """Return the time when the transmission of the next solution starts [ns]."""
        config = self._config
        exposure_ns = int(self.truth_ns(np.array([self._next]))[0])
        jitter_s = config.latency_jitter_s * float(self._jitter.random())
        end_ns = exposure_ns + round((config.latency_s + jitter_s) * 1e9)
        return end_ns - self.line.duration_ns(sagitta.SOLUTION_BYTES)

    def _expose(self) -> bytes:
        """Return the frame of the next solution."""
        config = self._config
        exposure = self.truth_ns(np.array([self._next]))
        state = self._history.at(self._clock.seconds(exposure))
        since_s = (int(exposure[0]) - self._power_on_ns) * 1e-9 + config.stamp_offset_s
        solution = sagitta.Solution(
            q_wxyz=attitude(state.R_NB[0], config, self._noise.draw()),
            unix_us=round((config.unix_epoch_s + since_s) * 1e6),
            ticks=round(since_s * 1e3),
            valid=self.valid,
            stable_count=self._next,
        )
        self._next += 1
        return sagitta.frame(sagitta.solution_payload(solution))

    def write(self, t_ns: int, data: bytes) -> None:
        """Accept bytes from the host; answers start ANSWER_NS later."""
        self._advance(t_ns)
        for payload in self._requests.feed(data):
            ids = sagitta.subscription_of(payload)
            if ids is not None:
                self.subscribed = sagitta.SOLUTION_ID in ids
            reply = sagitta.answer(payload)
            if reply is not None:
                start_ns = max(t_ns + ANSWER_NS, self.line.busy_until_ns)
                self.line.send([start_ns], [reply])

    def _advance(self, until_ns: int) -> None:
        """Transmit every solution that is due by this time."""
        while self._frame_start_ns <= until_ns:
            frame = self._expose()
            if self.subscribed:
                start_ns = max(self._frame_start_ns, self.line.busy_until_ns)
                self.line.send([start_ns], [frame])
            self._frame_start_ns = self._start_of_next()
        self.line.complete(until_ns)

    def next_ns(self) -> int:
        """Return when the host should read next [ns]: a known chunk, or the next transmission.

        A read at the start of a transmission puts the frame on the line, which has later times.
        """
        due = self.line.next_ns()
        return self._frame_start_ns if due is None else due

    def take(self, until_ns: int) -> list[TimedBytes]:
        """Return the chunks that the host has received by this time, with their times."""
        self._advance(until_ns)
        return self.line.take(until_ns)
