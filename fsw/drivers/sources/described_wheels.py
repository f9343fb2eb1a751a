"""Wheels of one bus whose frames a description gives: frames to timed samples."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsw.config import BusConfig, WheelConfig
from fsw.drivers.layout.joints import POSITION, TORQUE, Layout
from fsw.drivers.sources.counters import Counters
from fsw.drivers.sources.described_samples import DescribedSamples
from fsw.drivers.sources.wheels import SILENT_REPORTS
from fsw.drivers.wire import FrameArray, Reject
from fsw.messages import DeviceSamples
from fsw.messages.findings import Fault, Finding


class DescribedWheelSource:
    """Every described wheel of one bus.

    A report is timed as a described joint's sample is, less the wheel's delay. One without a time,
    out of range, with a bad status or not newer than the last is rejected.
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
        rates_hz = [wheel.rate_hz for wheel in self._wheels]
        self._samples = DescribedSamples(
            bus, self._wheels, [layouts[i] for i, _ in wheels], rates_hz
        )
        self._speed_limit = np.array([wheel.speed_limit_rad_s for wheel in self._wheels])
        self._torque_limit = np.array([wheel.torque_limit_nm for wheel in self._wheels])
        self._late_ns = np.array([round(wheel.delay_s * 1e9) for wheel in self._wheels])
        self._counts = [Counters() for _ in wheels]
        self._newest = np.full(len(wheels), -1)  # running number of the newest report
        self._values: dict[int, tuple[float, float]] = {}
        self._now_ns = 0

    @property
    def words(self) -> list[int]:
        """Identifiers of the wheels' frames, with flag bits."""
        return [int(word) for word in self._samples.words]

    def owns(self, frames: FrameArray) -> NDArray[np.bool_]:
        """Return (k,) which frames belong to the wheels."""
        return np.isin(frames["word"], self._samples.words)

    def feed(self, frames: FrameArray) -> DeviceSamples:
        """Accept frames in order, SYNCs among them, and return the samples they hold."""
        if len(frames):
            self._now_ns = int(frames["t_ns"][-1])
        timed, short, _ = self._samples.read(frames)
        for place, _, size in short:
            self._counts[place].reject(Reject.LENGTH, size)
        wheel, speed = timed.device, timed.values[:, POSITION]
        torque = timed.values[:, TORQUE].copy()
        torque[np.abs(torque) > self._torque_limit[wheel]] = np.nan
        good = np.ones(len(wheel), np.bool_)
        for k, place in enumerate(wheel.tolist()):
            number = int(timed.number[k])
            reasons = (
                (number < 0, Reject.STALE),
                (not (timed.is_good[k] and np.isfinite(speed[k])), Reject.STATUS),
                (abs(speed[k]) > self._speed_limit[place], Reject.RANGE),
                (number <= self._newest[place], Reject.SEQUENCE),
            )
            reason = next((why for is_bad, why in reasons if is_bad), None)
            if reason is not None:
                good[k] = False
                self._counts[place].reject(reason, 0)
                continue
            self._counts[place].accepted += 1
            self._newest[place] = number
            self._values[place] = float(speed[k]), float(torque[k])
        return DeviceSamples(
            section=self.kind,
            t_ns=(timed.t_ns - self._late_ns[wheel])[good],
            t_receive_ns=timed.done_ns[good],
            device=self._indexes[wheel[good]],
            values=np.column_stack([speed, torque])[good],
        )

    def findings(self) -> list[Finding]:
        """Return a finding for every silent wheel."""
        found = []
        for wheel, heard_ns in zip(self._wheels, self._samples.heard_ns, strict=True):
            age_s = 0.0 if heard_ns is None else (self._now_ns - heard_ns) * 1e-9
            if age_s * wheel.rate_hz > SILENT_REPORTS:
                text = f"no report for {age_s:.1f} s"
                found.append(Finding(self._now_ns, Fault.WHEEL_SILENT, wheel.name, text))
        return found

    def status(self) -> dict[str, dict[str, Any]]:
        """Return the newest values and the counters of every wheel, by name."""
        return {
            wheel.name: {"accepted": counts.accepted, "rejected": counts.rejected}
            | dict(zip(("speed_rad_s", "torque_nm"), self._values.get(place, ()), strict=False))
            for place, (wheel, counts) in enumerate(zip(self._wheels, self._counts, strict=True))
        }
