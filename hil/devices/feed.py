"""The simulated sender of a live feed, written from docs/howto/feed.md: all joints in datagrams."""

import hashlib
import hmac
import json
import struct
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from hil.devices.uart import TimedBytes
from hil.world.sensor_config import FeedConfig
from hil.world.sensors import generator

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Measure = Callable[[IntArray], tuple[FloatArray, FloatArray, FloatArray]]
KINDS = {"joints": 1, "imu": 2, "attitude": 3}
CLOCKS = {"monotonic": 0, "unix": 1, "tai": 2, "device": 3}
BATCH = 64


def packed(
    source: int,
    sequence: int,
    times_ns: tuple[int, int],
    values: Sequence[float],
    *,
    kind: str = "joints",
    clock: str = "monotonic",
    mask: int | None = None,
) -> bytes:
    """Return a packed datagram; `times_ns` are of validity and of sending."""
    count = len(values)
    bits = (1 << count) - 1 if mask is None else mask
    head = b"FSW1" + source.to_bytes(4, "little") + sequence.to_bytes(4, "little")
    head += bytes((KINDS[kind], CLOCKS[clock])) + count.to_bytes(2, "little")
    head += bits.to_bytes(8, "little")
    head += b"".join(t.to_bytes(8, "little", signed=True) for t in times_ns)
    return head + b"".join(struct.pack("<d", value) for value in values)


def as_json(
    source: int,
    sequence: int,
    times_ns: tuple[int, int],
    values: Sequence[float | None],
    *,
    kind: str = "joints",
    clock: str = "monotonic",
) -> bytes:
    """Return a datagram as JSON; a value that is not valid is None."""
    text = {
        "source": source,
        "sequence": sequence,
        "kind": kind,
        "clock": clock,
        "t_valid_ns": times_ns[0],
        "t_sent_ns": times_ns[1],
        "values": list(values),
    }
    return json.dumps(text).encode()


def sealed(datagram: bytes, key: bytes) -> bytes:
    """Return a datagram with its check value behind it."""
    return datagram + hmac.new(key, datagram, hashlib.sha256).digest()[:16]


class Feed:
    """Sends positions, torques and speeds of all joints at a steady rate.

    Parameters
    ----------
    measure : returns positions [rad], torques [N m], speeds [rad/s], each (k, n), at host times
    """

    def __init__(self, config: FeedConfig, measure: Measure, seed: int, t0_ns: int) -> None:
        rng = generator(seed, "feed", 0, 0)
        self.clock_error_ppm = 0.0
        if config.clock != "monotonic":
            self.clock_error_ppm = float(rng.uniform(-1.0, 1.0)) * config.clock_error_ppm
        self._config, self._measure, self._rng, self._t0_ns = config, measure, rng, t0_ns
        self._order = list(config.order) or slice(None)
        self._period_ns = 1e9 / config.rate_hz * (1.0 + 1e-6 * self.clock_error_ppm)
        self._first_ns = t0_ns + round(float(rng.uniform(0.0, 1.0)) * self._period_ns)
        self._key = None if config.key_hex is None else bytes.fromhex(config.key_hex)
        self._ready: deque[TimedBytes] = deque()
        self._next = 0
        self._arrived_ns = 0  # of the newest datagram; one does not overtake another
        self.lost = 0

    def reading_ns(self, t_ns: int) -> int:
        """Return the sender's clock at a host time [ns]."""
        if self._config.clock == "monotonic":
            return t_ns
        passed = (t_ns - self._t0_ns) / (1.0 + 1e-6 * self.clock_error_ppm)
        return round(self._config.clock_offset_s * 1e9) + round(passed)

    def next_ns(self) -> int:
        """Return the time when the host receives the next datagram [ns]."""
        while not self._ready:
            self._generate()
        return self._ready[0][0]

    def take(self, until_ns: int) -> list[TimedBytes]:
        """Return the datagrams that the host has received by this time, with their times."""
        found = []
        while self.next_ns() <= until_ns:
            found.append(self._ready.popleft())
        return found

    def _generate(self) -> None:
        """Measure and encode one batch of datagrams."""
        config = self._config
        numbers = np.arange(self._next, self._next + BATCH)
        self._next += BATCH
        valid_ns = self._first_ns + np.rint(numbers * self._period_ns).astype(np.int64)
        parts = [part[:, self._order] for part in self._measure(valid_ns)]
        values = np.concatenate(parts, axis=1).tolist()
        delays = config.delay_s + self._rng.exponential(config.jitter_s, BATCH)
        is_lost = self._rng.random(BATCH) < config.loss_ratio
        make = packed if config.encoding == "packed" else as_json
        rows = zip(numbers.tolist(), valid_ns.tolist(), values, delays, is_lost, strict=True)
        for number, t_ns, row, delay_s, lost in rows:
            if lost:
                self.lost += 1
                continue
            sent_ns = t_ns + round(config.latency_s * 1e9)
            times_ns = self.reading_ns(t_ns), self.reading_ns(sent_ns)
            data = make(config.source, number % (1 << 32), times_ns, row, clock=config.clock)
            self._arrived_ns = max(self._arrived_ns, sent_ns + round(delay_s * 1e9))
            data = data if self._key is None else sealed(data, self._key)
            self._ready.append((self._arrived_ns, data))
