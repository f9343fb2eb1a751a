"""Reaction wheel nodes of one CAN bus: frames to samples, timed by the SYNC they echo."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsw.config import BusConfig, WheelConfig
from fsw.drivers.codecs import canopen
from fsw.drivers.layout.shipped import READ_WHEEL, READ_WHEEL_SLOW, WHEEL, WHEEL_SLOW
from fsw.drivers.sources.counters import Counters
from fsw.drivers.sources.samples import SPEED, SampleSource
from fsw.drivers.sources.sync import history_of
from fsw.drivers.wire import FrameArray, Reject
from fsw.messages import DeviceSamples, FloatArray, IntArray
from fsw.messages.findings import Fault, Finding

SILENT_REPORTS = 5.0  # a wheel without a report for longer than this many periods is silent
STATUS_OF_SPEED = 0xD8  # speed valid, speed fault, SYNC lost, test data
STATUS_SPEED_VALID = 0x08
OWN_SERVICES = (canopen.COB_TPDO1, canopen.COB_TPDO2, canopen.COB_SYNC, canopen.COB_HEARTBEAT)


class WheelBusSource:
    """Every wheel node of one bus.

    A report is valid at the stamp of the SYNC whose counter it echoes plus the latch offset, less
    the wheel's delay. A report out of range, of another length or without its SYNC is rejected.
    """

    kind = "wheels"

    words: tuple[int, ...] = ()  # of frames that begin the grid of windows: a SYNC does

    def __init__(self, bus: BusConfig, wheels: list[tuple[int, WheelConfig]]) -> None:
        self._wheels = [config for _, config in wheels]
        self._indexes = np.array([index for index, _ in wheels], np.int64)
        self._place = np.full(canopen.NODE_MASK + 1, -1)
        nodes = [config.node_id for config in self._wheels if config.node_id is not None]
        self._place[nodes] = np.arange(len(wheels))
        self._speed_limit = np.array([config.speed_limit_rad_s for config in self._wheels])
        self._torque_limit = np.array([config.torque_limit_nm for config in self._wheels])
        self._senses_torque = np.array([config.torque == "measured" for config in self._wheels])
        self._bus = bus.name
        self._syncs = history_of(bus)
        late_s = np.array([bus.latch_offset_s - config.delay_s for config in self._wheels])
        self._offset_ns = np.rint(late_s * 1e9).astype(np.int64)
        self._counts = [Counters() for _ in wheels]
        self._newest: list[tuple[int, float, float] | None] = [None] * len(wheels)
        self._heard_ns: list[int | None] = [None] * len(wheels)  # SYNC of the newest report
        self._found: list[Finding] = []
        self._temperature_degc: dict[int, float] = {}
        self._now_ns = 0

    def owns(self, frames: FrameArray) -> NDArray[np.bool_]:
        """Return (k,) which frames belong to wheel nodes only; a SYNC does not."""
        words = frames["word"]
        own = (words <= canopen.COB_HEARTBEAT | canopen.NODE_MASK) & (words > canopen.COB_SYNC)
        own[own] = self._place[words[own] & canopen.NODE_MASK] >= 0
        own[own] = np.isin(words[own] & ~np.uint32(canopen.NODE_MASK), OWN_SERVICES)
        return np.asarray(own, np.bool_)

    def feed(self, frames: FrameArray) -> DeviceSamples:
        """Accept frames in order, SYNCs among them, and return the samples they hold."""
        words, data = frames["word"], frames["data"]
        self._now_ns = self._syncs.note(frames) or self._now_ns
        function, place = words & ~np.uint32(canopen.NODE_MASK), np.full(len(frames), -1)
        base = words <= canopen.COB_HEARTBEAT | canopen.NODE_MASK
        place[base] = self._place[words[base] & canopen.NODE_MASK]
        for row in np.flatnonzero((place >= 0) & (function == canopen.COB_TPDO2)).tolist():
            if frames["length"][row] == WHEEL_SLOW.length:
                (slow,) = READ_WHEEL_SLOW(data[row : row + 1])
                self._temperature_degc[int(place[row])] = float(slow[0])
        rows = np.flatnonzero((place >= 0) & (function == canopen.COB_TPDO1))
        return self._reports(frames.take(rows), rows, place[rows])

    def _reports(
        self, frames: FrameArray, rows: NDArray[np.intp], place: IntArray
    ) -> DeviceSamples:
        t_ns, length = frames["t_ns"].astype(np.int64), frames["length"]
        speed, torque, status, counter = READ_WHEEL(frames["data"])
        index, sync_ns, _, crept = self._syncs.match(counter, rows, t_ns)
        has_torque = canopen.torque_usable(status) & self._senses_torque[place]
        in_range = np.abs(speed) <= self._speed_limit[place]
        has_torque &= np.abs(torque) <= self._torque_limit[place]
        reasons = (
            (length != WHEEL.length, Reject.LENGTH),
            ((index < 0) | crept, Reject.STALE),
            (status & STATUS_OF_SPEED != STATUS_SPEED_VALID, Reject.STATUS),
            (~in_range, Reject.RANGE),
        )
        good = np.ones(len(frames), np.bool_)
        for k, size in enumerate(length.tolist()):
            counts = self._counts[place[k]]
            counts.received_bytes += size
            reason = next((why for bad, why in reasons if bad[k]), None)
            if crept[k]:
                text = self._syncs.movement
                self._heard_ns[place[k]] = int(sync_ns[k])
                self._found.append(Finding(int(t_ns[k]), Fault.SYNC_CREEPS, self._bus, text))
            newest = self._newest[place[k]]
            if reason is None and newest is not None and sync_ns[k] <= newest[0]:
                reason = Reject.SEQUENCE
            if reason is not None:
                good[k] = False
                counts.reject(reason, size)
                continue
            counts.accepted += 1
            counts.accepted_bytes += size
            self._heard_ns[place[k]] = int(sync_ns[k])
            self._newest[place[k]] = (int(sync_ns[k]), float(speed[k]), float(torque[k]))
        torque = np.where(has_torque, torque, np.nan)
        return DeviceSamples(
            section=self.kind,
            t_ns=sync_ns[good] + self._offset_ns[place[good]],
            t_receive_ns=t_ns[good],
            device=self._indexes[place[good]],
            values=np.column_stack([speed, torque])[good],
        )

    def findings(self) -> list[Finding]:
        """Return the findings since the last call, and one for every silent wheel."""
        found, self._found = self._found, []
        for config, heard_ns in zip(self._wheels, self._heard_ns, strict=True):
            if heard_ns is None:
                continue
            age_s = (self._now_ns - heard_ns) * 1e-9
            if age_s * config.rate_hz > SILENT_REPORTS:
                text = f"no report for {age_s:.1f} s"
                found.append(Finding(self._now_ns, Fault.WHEEL_SILENT, config.name, text))
        return found

    def status(self) -> dict[str, dict[str, Any]]:
        """Return the newest values and the counters of every wheel, by name."""
        values: dict[str, dict[str, Any]] = {}
        for place, config in enumerate(self._wheels):
            counts, newest = self._counts[place], self._newest[place]
            own: dict[str, Any] = {"accepted": counts.accepted, "rejected": counts.rejected}
            if newest is not None:
                own |= {"speed_rad_s": newest[1], "torque_nm": newest[2]}
            if place in self._temperature_degc:
                own["temperature_degc"] = self._temperature_degc[place]
            values[config.name] = own
        return values


def wheel_samples(wheels: Sequence[WheelConfig]) -> SampleSource:
    """Return the source of all reaction wheels: speeds [rad/s] by name of the wheel."""
    names, n = [wheel.name for wheel in wheels], len(wheels)
    limits = np.array([wheel.speed_limit_rad_s for wheel in wheels])
    delays_ns = np.array([round(wheel.delay_s * 1e9) for wheel in wheels], np.int64)

    def row(message: Mapping[str, Any]) -> list[float]:
        return [float(message[SPEED].get(name, np.nan)) for name in names]

    def build(t_ns: IntArray, t_receive_ns: IntArray, values: FloatArray) -> DeviceSamples:
        wheel, stamps = np.tile(np.arange(n), len(t_ns)), np.repeat(t_ns, n)
        speed = values.reshape(-1)
        good = np.abs(speed) <= limits[wheel]
        wheel, stamps, speed = wheel[good], stamps[good], speed[good]
        return DeviceSamples(
            section="wheels",
            t_ns=stamps - delays_ns[wheel],
            t_receive_ns=np.repeat(t_receive_ns, n)[good],
            device=wheel,
            values=np.column_stack([speed, np.full(len(speed), np.nan)]),
        )

    return SampleSource(row, build, n)
