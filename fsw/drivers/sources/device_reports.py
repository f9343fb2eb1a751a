"""Reports of devices of one kind on one bus: read by their descriptions, timed, and judged."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.config import BusConfig
from fsw.drivers.codecs import canopen
from fsw.drivers.layout.joints import Layout
from fsw.drivers.sources.counters import Counters
from fsw.drivers.sources.described_samples import DescribedSamples, Timed
from fsw.drivers.sources.line_watch import LineFaults, LineWatch
from fsw.drivers.wire import FrameArray, Reject
from fsw.messages.findings import Fault, Finding

SILENT_REPORTS = 5.0  # a device without a report for longer than this many periods is silent
SERVICES = (canopen.COB_EMCY, canopen.COB_TPDO1, canopen.COB_TPDO2, canopen.COB_HEARTBEAT)


class Reporter(NamedTuple):
    """A device that sends reports."""

    name: str
    rate_hz: float
    layout: Layout
    node_id: int | None  # of a CANopen node, which has other services too; None: not a node


class Reports:
    """Reports of devices of one bus.

    A report without a time, with a bad status, out of range or not newer than the last is rejected.

    Parameters
    ----------
    line : faults of a silent device, of lost reports, and so on
    refused : fault of a report, by the reason for its rejection; empty: neither rejected nor lost
        reports are findings
    """

    def __init__(
        self,
        bus: BusConfig,
        devices: Sequence[Reporter],
        line: LineFaults,
        refused: Mapping[Reject, Fault] | None = None,
        silent_periods: float = SILENT_REPORTS,
    ) -> None:
        self._bus, self._refused = bus.name, dict(refused or {})
        if refused:
            self._refused |= {Reject.LENGTH: line.damaged, Reject.STALE: line.clock}
            self._refused |= {Reject.SEQUENCE: line.doubled}
        names, rates_hz, layouts, ids = zip(*devices, strict=True)
        self._samples = DescribedSamples(bus, layouts, rates_hz)
        services = [service | node for node in ids if node is not None for service in SERVICES]
        self._owned = np.union1d(self._samples.words, np.array(services, np.uint32))
        self.counts = [Counters() for _ in devices]
        self._newest = [(-1, 0)] * len(devices)  # running number and time of the newest report
        self._rates_hz = rates_hz
        self._watches = [
            LineWatch(line, name, 1e9 / rate_hz, silent_periods)
            for name, rate_hz in zip(names, rates_hz, strict=True)
        ]
        self._found: list[Finding] = []

    @property
    def words(self) -> list[int]:
        """Identifiers of the reports, with flag bits."""
        return [int(word) for word in self._samples.words]

    @property
    def counters(self) -> dict[str, int]:
        """Counters of all devices together."""
        each = [own.as_dict() for own in self.counts]
        sums = {key: sum(own[key] for own in each) for key in each[0]}
        return sums | {"incomplete": self._samples.headless}

    def owns(self, frames: FrameArray) -> NDArray[np.bool_]:
        """Return (k,) which frames belong to the devices only; a SYNC does not."""
        return np.isin(frames["word"], self._owned)

    def read(self, frames: FrameArray) -> Timed:
        """Accept frames in order, SYNCs among them; return the reports they hold."""
        timed, short = self._samples.read(frames)
        for place, t_ns, size in short:
            self._refuse(place, t_ns, Reject.LENGTH, size, f"{size} bytes")
        return timed

    def good(
        self, timed: Timed, has_value: NDArray[np.bool_], in_range: NDArray[np.bool_]
    ) -> NDArray[np.intp]:
        """Return the rows of the reports that are accepted; count all.

        Parameters
        ----------
        has_value, in_range : (k,) whether a report holds a usable value, and one that may be
        """
        rows = []
        for k, place in enumerate(timed.device.tolist()):
            number, done_ns = int(timed.number[k]), int(timed.done_ns[k])
            if timed.crept[k]:  # of the bus
                self.counts[place].reject(Reject.STALE, 0)
                self._watches[place].refused(done_ns, 0)
                text = self._samples.movement
                self._found.append(Finding(done_ns, Fault.SYNC_CREEPS, self._bus, text))
                continue
            newest, before_ns = self._newest[place]
            reasons = (
                (number < 0, Reject.STALE),
                (not (timed.is_good[k] and has_value[k]), Reject.STATUS),
                (not in_range[k], Reject.RANGE),
                (number <= newest, Reject.SEQUENCE),
            )
            reason = next((why for is_bad, why in reasons if is_bad), None)
            if reason is not None:
                text = "no usable value" if timed.is_good[k] else f"status 0x{timed.status[k]:x}"
                self._refuse(place, done_ns, reason, 0, text)
                continue
            t_ns, lost = int(timed.t_ns[k]), 0
            if self._refused and newest >= 0:
                periods = round((t_ns - before_ns) * 1e-9 * self._rates_hz[place])
                lost = max(0, periods - 1)
                self.counts[place].lost += lost
            self.counts[place].accepted += 1
            self._newest[place] = number, t_ns
            self._watches[place].accepted(done_ns, 0, lost, 0)
            rows.append(k)
        return np.array(rows, np.intp)

    def find(self, place: int, t_ns: int, fault: Fault, text: str) -> None:
        """Add a finding about a device."""
        self._watches[place].find(t_ns, fault, text)

    def _refuse(self, place: int, t_ns: int, reason: Reject, size: int, text: str) -> None:
        """Count a report that is not used; report it if such ones are findings."""
        self.counts[place].reject(reason, size)
        if reason in self._refused:
            is_said = reason in (Reject.LENGTH, Reject.STATUS)
            self.find(place, t_ns, self._refused[reason], text if is_said else "")
            if reason is not Reject.LENGTH:  # found before the others of its batch
                self._watches[place].refused(t_ns, 0)

    def watch(self, now_ns: int, *, up: bool) -> None:
        """Report silent devices; a missing port (`up` is False) explains their silence."""
        for watch in self._watches:
            watch.watch(now_ns, up=up)

    def findings(self) -> list[Finding]:
        """Return the findings since the last call."""
        found, self._found = self._found, []
        return found + [finding for watch in self._watches for finding in watch.take()]
