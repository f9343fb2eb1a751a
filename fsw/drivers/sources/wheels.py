"""Reaction wheels of one bus: frames that a description gives to timed samples."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fsw.config import BusConfig
from fsw.config.wheels import WheelConfig
from fsw.drivers.codecs import canopen
from fsw.drivers.layout.decoder import Decoder
from fsw.drivers.layout.joints import POSITION, TORQUE, Layout
from fsw.drivers.layout.shipped import (
    NODE_ROLES,
    POSITION_SCALE_RAD,
    TEMPERATURE_SCALE_K,
    message_of,
    shipped,
)
from fsw.drivers.sources.device_reports import Reporter, Reports
from fsw.drivers.sources.line_watch import silent_only
from fsw.drivers.sources.samples import SPEED, SampleSource
from fsw.drivers.wire import FrameArray
from fsw.messages import DeviceSamples, FloatArray, IntArray
from fsw.messages.findings import Fault

REPORT = message_of(
    "wheel",
    ("speed", 32, "signed", POSITION_SCALE_RAD),
    ("torque", 16, "signed", 1e-4),
    ("status", 8, "unsigned", 1),
    ("counter", 8, "unsigned", 1),
)
ROLES = {"speed": POSITION, "torque": TORQUE} | NODE_ROLES
SLOW = message_of("wheel_slow", ("temperature", 16, "signed", TEMPERATURE_SCALE_K))
READ_SLOW = Decoder(SLOW, SLOW.named("temperature"))


class WheelBusSource:
    """Every wheel of one bus.

    A report is timed as a described joint's sample, minus the wheel's delay.

    Parameters
    ----------
    layouts : layout by index of the wheel; tailored nodes have none
    """

    kind = "wheels"

    def __init__(
        self,
        bus: BusConfig,
        wheels: Sequence[tuple[int, WheelConfig]],
        layouts: Mapping[int, Layout],
    ) -> None:
        self._wheels = [wheel for _, wheel in wheels]
        self._indexes = np.array([index for index, _ in wheels], np.int64)
        known = [
            layouts.get(i) or shipped(REPORT, ROLES, canopen.COB_TPDO1 | (wheel.node_id or 0))
            for i, wheel in wheels
        ]
        reporters = [
            Reporter(own.name, own.rate_hz, layout, own.node_id)
            for own, layout in zip(self._wheels, known, strict=True)
        ]
        self._reports = Reports(bus, reporters, silent_only(Fault.WHEEL_SILENT))
        self.words, self.owns = self._reports.words, self._reports.owns
        self.watch, self.findings = self._reports.watch, self._reports.findings
        tailored = [wheel.node_id if wheel.driver == "canopen" else None for wheel in self._wheels]
        self._slow = {canopen.COB_TPDO2 | node: k for k, node in enumerate(tailored) if node}
        self._is_tailored = np.array([node is not None for node in tailored])
        self._senses_torque = np.array([wheel.torque == "measured" for wheel in self._wheels])
        self._speed_limit = np.array([wheel.speed_limit_rad_s for wheel in self._wheels])
        self._torque_limit = np.array([wheel.torque_limit_nm for wheel in self._wheels])
        self._late_ns = np.array([round(wheel.delay_s * 1e9) for wheel in self._wheels])
        self._values: list[dict[str, float]] = [{} for _ in wheels]

    @property
    def counters(self) -> dict[str, int]:
        """Counters of all reports."""
        return self._reports.counters

    def feed(self, frames: FrameArray) -> DeviceSamples:
        """Accept frames in order, SYNCs among them, and return the samples they hold."""
        for row in np.flatnonzero(np.isin(frames["word"], list(self._slow))).tolist():
            if frames["length"][row] == SLOW.length:
                (slow,) = READ_SLOW(frames["data"][row : row + 1])
                place = self._slow[int(frames["word"][row])]
                self._values[place]["temperature_degc"] = float(slow[0])
        timed = self._reports.read(frames)
        wheel, speed, torque = timed.device, timed.values[:, POSITION], timed.values[:, TORQUE]
        is_known = np.isfinite(speed)
        in_range = np.abs(speed) <= self._speed_limit[wheel]
        rows = self._reports.good(timed, is_known, in_range)
        has_torque = self._senses_torque[wheel] & (np.abs(torque) <= self._torque_limit[wheel])
        has_torque &= canopen.torque_usable(timed.status) | ~self._is_tailored[wheel]
        pairs = np.column_stack([speed, torque])[rows].tolist()
        for place, pair in zip(wheel[rows].tolist(), pairs, strict=True):
            named = zip(("speed_rad_s", "torque_nm"), pair, strict=True)
            self._values[place] |= {name: value for name, value in named if np.isfinite(value)}
        return DeviceSamples(
            section=self.kind,
            t_ns=(timed.t_ns - self._late_ns[wheel])[rows],
            t_receive_ns=timed.done_ns[rows],
            device=self._indexes[wheel[rows]],
            values=np.column_stack([speed, np.where(has_torque, torque, np.nan)])[rows],
        )

    def status(self) -> dict[str, dict[str, Any]]:
        """Return the newest values and the counters of every wheel, by name."""
        rows = zip(self._wheels, self._reports.counts, self._values, strict=True)
        return {
            wheel.name: {"accepted": counts.accepted, "rejected": counts.rejected} | values
            for wheel, counts, values in rows
        }


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
