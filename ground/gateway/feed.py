"""The daemon's telemetry: received over a connection that is kept up, decoded and distributed."""

import asyncio
import math
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ground.downlink import ClearStream, PacketStream
from ground.errors import GroundError
from ground.gateway.history import Ring
from ground.gateway.points import EVENTS, Points, event_of
from ground.telemetry import FILE_UNIT, UNKNOWN, Sample, TelemetryDecoder
from ground.utc import Correlation

RETRY_S = 1.0
READ_BYTES = 65536
MAX_EVENTS = 2000
MAX_KINDS = 100  # kinds of unknown packets that are counted separately
FEWEST_STALE_S = 2.0
STALE_INTERVALS = 3.0
EVENT_LATE_S = 5.0  # an event carries the time at which it happened; it may arrive this late
JUMP_MS = 1000.0  # a larger jump of the clock's offset is accepted as a new offset
Listener = Callable[[str, float, dict[str, float]], None]


@dataclass(slots=True)
class Arrivals:
    """Times at which packets of one kind arrived."""

    last_s: float = -math.inf
    gaps_s: deque[float] = field(default_factory=lambda: deque(maxlen=5))

    def note(self, now_s: float) -> None:
        """Note the arrival of a packet."""
        if math.isfinite(self.last_s):
            self.gaps_s.append(now_s - self.last_s)
        self.last_s = now_s

    def is_stale(self, now_s: float) -> bool:
        """Return whether the next packet is overdue; False until three have arrived."""
        if len(self.gaps_s) < 2:
            return False
        usual_s = sorted(self.gaps_s)[len(self.gaps_s) // 2]
        return now_s - self.last_s > max(FEWEST_STALE_S, STALE_INTERVALS * usual_s)


class Feed:
    """One connection to the daemon, opened again when it is lost.

    Parameters
    ----------
    listener : receives a packet's name, its time [ms since 1970] and its numbers by field
    make_stream : makes the stream that splits the bytes of a new connection into packets
    """

    def __init__(
        self,
        host: str,
        port: int,
        points: Points,
        listener: Listener,
        make_stream: Callable[[], PacketStream] = ClearStream,
    ) -> None:
        self._host, self._port, self._make_stream = host, port, make_stream
        self._points, self._listener = points, listener
        self._decoder = TelemetryDecoder()
        self._rings: dict[str, Ring] = {}
        self._arrivals: dict[str, Arrivals] = {}
        self.events: deque[dict[str, Any]] = deque(maxlen=MAX_EVENTS)
        self.latest: dict[str, tuple[float, dict[str, float]]] = {}
        self.offset_ms: float | None = None  # time of day less the daemon's clock
        self.correlation = Correlation()
        self.connected = False
        self.reason = "not connected yet"
        self.packets = 0
        self.played_back = 0
        self._newest_s: dict[str, float] = {}  # times of the newest packets of this connection
        self.unknown: Counter[str] = Counter()  # packets that are not in the dictionary, by kind

    async def run(self) -> None:
        """Connect and read until cancelled."""
        while True:
            try:
                reader, writer = await asyncio.open_connection(self._host, self._port)
            except OSError as error:
                self.reason = error.strerror or str(error)
            else:
                self.connected = True
                try:
                    await self._read(reader)
                except (OSError, GroundError) as error:
                    self.reason = str(error)
                except Exception as error:  # noqa: BLE001  the reader never ends silently
                    self.reason = f"the reader failed: {type(error).__name__}: {error}"
                    self.add_event("high", "READER_FAILED", self.reason, time.time_ns() / 1e6)
                finally:
                    self.connected = False
                    writer.close()
            await asyncio.sleep(RETRY_S)

    def stale_packets(self) -> set[str]:
        """Return the names of overdue packets; of all packets while there is no connection."""
        if not self.connected:
            return set(self._points.packets)
        now_s = time.monotonic()
        return {name for name, arrivals in self._arrivals.items() if arrivals.is_stale(now_s)}

    def between(
        self, packet: str, name: str, start_ms: float, end_ms: float
    ) -> NDArray[np.float64]:
        """Return times [ms] and values (n, 2) of a field within an interval."""
        ring = self._rings.get(packet)
        return np.empty((0, 2)) if ring is None else ring.between(name, start_ms, end_ms)

    async def _read(self, reader: asyncio.StreamReader) -> None:
        stream = self._make_stream()
        self._newest_s.clear()  # the clock of a restarted machine begins at 0
        try:
            while data := await reader.read(READ_BYTES):
                stream.add(data)
                for packet in stream.packets():
                    self._take(packet)
        finally:
            stream.close()
        self.reason = "closed by the daemon"

    def _take(self, packet: bytes) -> None:
        sample = self._decoder.decode(packet)
        self.packets += 1
        if self._is_played_back(sample):
            self.played_back += 1
            return
        self.correlation.take(sample)
        event = event_of(sample)
        t_ms = self._time_of_day_ms(sample.time_s, moves_clock=event is None)
        if sample.packet == UNKNOWN:
            self._count_unknown(sample, t_ms)
        if sample.packet in (UNKNOWN, FILE_UNIT):
            return
        if event is not None:
            self.add_event(event["severity"], event["code"], event["text"], t_ms)
            return
        if sample.packet not in self._points.packets:
            return
        self._arrivals.setdefault(sample.packet, Arrivals()).note(time.monotonic())
        numbers = self._points.numbers(sample)
        if sample.packet not in self._rings:
            fields = [point.field for point in self._points.packets[sample.packet]]
            self._rings[sample.packet] = Ring(fields)
        self._rings[sample.packet].add(t_ms, numbers)
        self.latest[sample.packet] = t_ms, numbers
        self._listener(sample.packet, t_ms, numbers)

    def _is_played_back(self, sample: Sample) -> bool:
        """Return whether a newer packet of this name came before: this one is from a packet store.

        Old values must neither replace new ones nor change the clock's offset.
        """
        newest_s = self._newest_s.get(sample.packet, -math.inf)
        if sample.time_s > newest_s:
            self._newest_s[sample.packet] = sample.time_s
        late_s = EVENT_LATE_S if event_of(sample) is not None else 0.0
        return sample.time_s < newest_s - late_s

    def _count_unknown(self, sample: Sample, t_ms: float) -> None:
        """Count a packet that is not in the dictionary; report the first of each kind as event."""
        names = ("apid", "service", "subtype")
        kind = " ".join(f"{name} {sample.values[name]}" for name in names if name in sample.values)
        if kind not in self.unknown and len(self.unknown) < MAX_KINDS:
            text = f"{kind}, {sample.values['size_bytes']} bytes: {sample.values['raw']}"
            self.add_event("low", "UNKNOWN_PACKET", text, t_ms)
        if kind in self.unknown or len(self.unknown) < MAX_KINDS:
            self.unknown[kind] += 1
        else:
            self.unknown["other"] += 1

    def add_event(self, severity: str, code: str, text: str, t_ms: float) -> None:
        """Add an event of the ground or of the daemon, at its time of day [ms since 1970]."""
        self.events.append({"severity": severity, "code": code, "text": text, "utc": t_ms})
        self._listener(EVENTS, t_ms, {})

    def _time_of_day_ms(self, time_s: float, *, moves_clock: bool) -> float:
        """Return a mission elapsed time [s] as time of day [ms since 1970].

        While the daemon's clock is synchronised to UTC, the daemon's correlation is used. Otherwise
        the offset is the smallest difference between this machine's clock and a packet's time. An
        event does not change the offset, because it carries the time at which it happened.
        """
        now_ms = time.time_ns() / 1e6
        if math.isnan(time_s):
            return now_ms
        if self.correlation.synchronised and self.correlation.offset_s is not None:
            return 1e3 * (self.correlation.offset_s + time_s)
        offset_ms = now_ms - 1e3 * time_s
        known_ms = self.offset_ms
        if known_ms is None or (
            moves_clock and (offset_ms < known_ms or offset_ms - known_ms > JUMP_MS)
        ):
            self.offset_ms = known_ms = offset_ms
        return 1e3 * time_s + known_ms
