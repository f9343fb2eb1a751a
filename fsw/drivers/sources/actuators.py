"""Reports of actuators of one kind on one bus: read by their descriptions, timed, and judged."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.config import BusConfig
from fsw.drivers.codecs import canopen
from fsw.drivers.layout.joints import Layout
from fsw.drivers.sources.counters import Counters
from fsw.drivers.sources.described_samples import DescribedSamples, Timed
from fsw.drivers.wire import FrameArray, Reject
from fsw.messages.findings import Fault, Finding

SILENT_REPORTS = 5.0  # a device without a report for longer than this many periods is silent
SERVICES = (canopen.COB_EMCY, canopen.COB_TPDO1, canopen.COB_TPDO2, canopen.COB_HEARTBEAT)


class Reporter(NamedTuple):
    """A device that sends reports."""

    name: str
    rate_hz: float
    layout: Layout
    node_id: int | None  # of a tailored node, which has other services too; None: of a foreign one


class Reports:
    """Reports of devices of one bus.

    A report without a time, with a bad status, out of range or not newer than the last is rejected.

    Parameters
    ----------
    silent : what a silent device is
    """

    def __init__(self, bus: BusConfig, devices: Sequence[Reporter], silent: Fault) -> None:
        self._bus, self._devices, self._silent = bus.name, devices, silent
        _, rates_hz, layouts, ids = zip(*devices, strict=True)
        self._samples = DescribedSamples(bus, layouts, rates_hz)
        services = [service | node for node in ids if node is not None for service in SERVICES]
        self._owned = np.union1d(self._samples.words, np.array(services, np.uint32))
        self.counts = [Counters() for _ in devices]
        self._newest = [-1] * len(devices)  # running number of the newest report
        self._heard_ns: list[int | None] = [None] * len(devices)
        self._found: list[Finding] = []
        self._now_ns = 0

    @property
    def words(self) -> list[int]:
        """Identifiers of the reports, with flag bits."""
        return [int(word) for word in self._samples.words]

    def owns(self, frames: FrameArray) -> NDArray[np.bool_]:
        """Return (k,) which frames belong to the devices only; a SYNC does not."""
        return np.isin(frames["word"], self._owned)

    def read(self, frames: FrameArray) -> Timed:
        """Accept frames in order, SYNCs among them; return the reports they hold."""
        if len(frames):
            self._now_ns = int(frames["t_ns"][-1])
        timed, short = self._samples.read(frames)
        for place, _, size in short:
            self.counts[place].reject(Reject.LENGTH, size)
        return timed

    def good(self, timed: Timed, in_range: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Return the rows of the reports that are accepted; count all."""
        rows = []
        for k, place in enumerate(timed.device.tolist()):
            number, done_ns = int(timed.number[k]), int(timed.done_ns[k])
            reasons = (
                (number < 0, Reject.STALE),
                (not timed.is_good[k], Reject.STATUS),
                (not in_range[k], Reject.RANGE),
                (number <= self._newest[place], Reject.SEQUENCE),
            )
            reason = next((why for is_bad, why in reasons if is_bad), None)
            if timed.crept[k]:
                self._heard_ns[place], text = done_ns, self._samples.movement
                self._found.append(Finding(done_ns, Fault.SYNC_CREEPS, self._bus, text))
            if reason is not None:
                self.counts[place].reject(reason, 0)
                continue
            self.counts[place].accepted += 1
            self._newest[place], self._heard_ns[place] = number, done_ns
            rows.append(k)
        return np.array(rows, np.intp)

    def findings(self) -> list[Finding]:
        """Return the findings since the last call, and one for every silent device."""
        found, self._found = self._found, []
        for device, heard_ns in zip(self._devices, self._heard_ns, strict=True):
            age_s = 0.0 if heard_ns is None else (self._now_ns - heard_ns) * 1e-9
            if age_s * device.rate_hz > SILENT_REPORTS:
                text = f"no report for {age_s:.1f} s"
                found.append(Finding(self._now_ns, self._silent, device.name, text))
        return found
