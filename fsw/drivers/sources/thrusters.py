"""Thrusters of one CAN bus: frames that a description gives to timed states of valves."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fsw.config import BusConfig
from fsw.config.thrusters import ThrusterConfig
from fsw.drivers.codecs.canopen import COB_TPDO1
from fsw.drivers.layout.joints import CHANGE, TIME, VALVE, Layout
from fsw.drivers.layout.shipped import NODE_ROLES, message_of, shipped
from fsw.drivers.sources.device_reports import Reporter, Reports
from fsw.drivers.sources.line_watch import silent_only
from fsw.drivers.wire import FrameArray
from fsw.messages import DeviceSamples
from fsw.messages.findings import Fault

COUNT = 256  # modulus of the counter of changes
AGE_SCALE_NS = 10_000
OLD_NS = 0xFFFF * AGE_SCALE_NS  # the newest change is this old or older, or there was none
AGES_S = 1e8  # longer than any flight
SURE_SIGMAS = 6.0  # by which stamps may be wrong
REPORT = message_of(
    "thruster",
    ("valves", 16, "unsigned", 1),
    ("age", 16, "unsigned", AGE_SCALE_NS * 1e-9),
    ("changes", 8, "unsigned", 1),
    ("reserved", 8, "unsigned", 1),
    ("status", 8, "unsigned", 1),
    ("counter", 8, "unsigned", 1),
)
ROLES = {"valves": VALVE, "age": CHANGE, "changes": TIME} | NODE_ROLES
_Row = tuple[int, int, int, float, float]  # time, receive stamp, thruster, state, is_change


class _Node:
    """One valve driver and its newest report.

    A tailored node counts the changes of its valves. Another device has one valve, and says how old
    its newest change is, or for how long it has been open, a number that wraps.
    """

    def __init__(self, layout: Layout | None, node_id: int, first: ThrusterConfig) -> None:
        self.thrusters: list[tuple[int, ThrusterConfig]] = []  # index, thruster
        self.layout = layout or shipped(REPORT, ROLES, COB_TPDO1 | node_id)
        self._is_tailored = layout is None
        self._wrap_s, self._rounding_ns = 0.0, AGE_SCALE_NS
        change = self.layout.use(CHANGE)
        if layout is not None and change is not None:
            step_s = abs(change.signal.scale) * change.factor
            self._wrap_s = step_s * 2.0**change.signal.bits * ("on_time" in (first.signals or {}))
            doubt_s = step_s + SURE_SIGMAS * (layout.timing.sigma_s or 0.0)
            self._rounding_ns += round(doubt_s * 1e9)
        self._latch_ns: int | None = None
        self.valves = self._changes = 0
        self._told_s = 0.0

    def is_open(self, config: ThrusterConfig) -> int:
        """Return the newest state of a thruster's valve."""
        return self.valves >> config.valve & 1 if self._is_tailored else self.valves

    def states(
        self, latch_ns: int, received_ns: int, valves: float, told_s: float, changes: float
    ) -> list[_Row]:
        """Accept a report; return its rows."""
        before_ns, before = self._latch_ns, [self.is_open(own) for _, own in self.thrusters]
        first, age_ns = before_ns is None, round(min(told_s, AGES_S) * 1e9) if told_s >= 0 else -1
        several, gap_ns = 0, latch_ns - (before_ns or latch_ns)
        if self._is_tailored:
            several = (int(changes) - self._changes) % COUNT
            age_ns = -1 if age_ns == OLD_NS else age_ns
            self.valves, self._changes = int(valves), int(changes)
        else:
            several, age_ns = self._changed(bool(valves), told_s, age_ns, gap_ns)
            self.valves, self._told_s = int(valves != 0), told_s
        in_gap = 0 <= age_ns <= gap_ns + self._rounding_ns
        is_clear = several == 0 or (several == 1 and in_gap)
        found = list[_Row]()
        for (index, config), was_open in zip(self.thrusters, before, strict=True):
            state = self.is_open(config)
            if not first and not is_clear:
                found.append((latch_ns, received_ns, index, float("nan"), 0.0))
            elif not first and state != was_open:
                change_ns = max(latch_ns - age_ns, latch_ns - gap_ns + 1)
                found.append((change_ns, received_ns, index, float(state), 1.0))
            found.append((latch_ns, received_ns, index, float(state), 0.0))
        self._latch_ns = latch_ns
        return found

    def _changed(self, is_open: bool, told_s: float, age_ns: int, gap_ns: int) -> tuple[int, int]:
        """Return how often a device's valve has changed, 2: or more; and how old the newest is.

        A time open that was not told, now or before, may hide any number of changes.
        """
        differs = is_open != bool(self.valves)
        if not self._wrap_s:
            return (1 if differs else 2 * (0 <= age_ns < gap_ns - self._rounding_ns)), age_ns
        open_s = told_s - self._told_s
        if not np.isfinite(open_s):
            return 2, -1
        open_ns = round((open_s - np.floor(open_s / self._wrap_s + 1e-9) * self._wrap_s) * 1e9)
        if differs:
            age_ns = open_ns if is_open else gap_ns - open_ns
            return 1, max(0, age_ns) if age_ns > -self._rounding_ns else -1
        expected_ns = gap_ns if is_open else 0
        return 2 * (abs(open_ns - expected_ns) > self._rounding_ns), -1


class ThrusterBusSource:
    """Every thruster of one bus.

    A report gives the valves' states at its time, and the time of the newest change. If more than
    one change lies between two reports, as after lost reports, a NaN marks the unknown changes. A
    described valve does not count its changes, so several show only if its state is the old one.

    Parameters
    ----------
    layouts : layout by index of the thruster; tailored nodes have none
    """

    kind = "thrusters"

    def __init__(
        self,
        bus: BusConfig,
        thrusters: Sequence[tuple[int, ThrusterConfig]],
        layouts: Mapping[int, Layout],
    ) -> None:
        nodes = dict[tuple[bool, int], _Node]()
        for index, config in thrusters:
            layout, number = layouts.get(index), config.node_id or 0
            key = (True, number) if layout is None else (False, index)
            node = nodes.setdefault(key, _Node(layout, number, config))
            node.thrusters.append((index, config))
        self._nodes = list(nodes.values())
        reporters = [
            Reporter(own.name, own.rate_hz, node.layout, own.node_id)
            for node in self._nodes
            for _, own in node.thrusters[:1]
        ]
        self._reports = Reports(bus, reporters, silent_only(Fault.THRUSTER_SILENT))
        self.words, self.owns = self._reports.words, self._reports.owns
        self.watch, self.findings = self._reports.watch, self._reports.findings

    @property
    def counters(self) -> dict[str, int]:
        """Counters of all reports."""
        return self._reports.counters

    def feed(self, frames: FrameArray) -> DeviceSamples:
        """Accept frames in order, SYNCs among them, and return the states they hold."""
        timed = self._reports.read(frames)
        told = timed.values[:, [VALVE, CHANGE, TIME]]
        rows = self._reports.good(timed, np.isfinite(told[:, 0]), np.ones(len(told), np.bool_))
        columns = (timed.device, timed.t_ns, timed.done_ns, *told.T)
        found = list[_Row]()
        for place, *report in zip(*(column[rows].tolist() for column in columns), strict=True):
            found += self._nodes[place].states(*report)
        states = np.array(found, np.float64).reshape(-1, 5)
        times = np.array([row[:2] for row in found], np.int64).reshape(-1, 2)
        return DeviceSamples(
            section=self.kind,
            t_ns=times[:, 0],
            t_receive_ns=times[:, 1],
            device=states[:, 2].astype(np.int64),
            values=states[:, 3:],
        )

    def status(self) -> dict[str, dict[str, Any]]:
        """Return the newest state of every thruster and its node's counters, by name."""
        return {
            config.name: {
                "accepted": counts.accepted,
                "rejected": counts.rejected,
                "open": float(node.is_open(config)),
            }
            for node, counts in zip(self._nodes, self._reports.counts, strict=True)
            for _, config in node.thrusters
        }
