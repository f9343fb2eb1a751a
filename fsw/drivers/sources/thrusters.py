"""Thruster nodes of one CAN bus: frames to states of valves, timed by the SYNC they echo."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fsw.config import BusConfig
from fsw.config.thrusters import ThrusterConfig
from fsw.drivers.codecs.canopen import COB_TPDO1
from fsw.drivers.layout.joints import POSITION, TIME, TORQUE
from fsw.drivers.layout.shipped import NODE_ROLES, message_of, shipped
from fsw.drivers.sources.actuators import Reporter, Reports
from fsw.drivers.wire import FrameArray
from fsw.messages import DeviceSamples
from fsw.messages.findings import Fault

COUNT = 256  # modulus of the counter of changes
AGE_SCALE_NS = 10_000
OLD = 0xFFFF  # age on the wire: the newest change is this old or older, or there was none
REPORT = message_of(
    "thruster",
    ("valves", 16, "unsigned", 1),
    ("age", 16, "unsigned", 1),
    ("changes", 8, "unsigned", 1),
    ("reserved", 8, "unsigned", 1),
    ("status", 8, "unsigned", 1),
    ("counter", 8, "unsigned", 1),
)
ROLES = {"valves": POSITION, "age": TORQUE, "changes": TIME} | NODE_ROLES


@dataclass(slots=True)
class _Node:
    """One valve driver and its newest report."""

    thrusters: list[tuple[int, ThrusterConfig]] = field(default_factory=list)  # index, thruster
    latch_ns: int | None = None  # latch time of the newest report
    valves: int = 0
    changes: int = 0


class ThrusterBusSource:
    """Every thruster node of one bus.

    A report is valid at the stamp of the SYNC whose counter it echoes plus the latch offset. It
    gives the valves' states at this time and the time of the newest change. If more than one
    change lies between two reports, as after lost reports, a NaN marks the unknown changes.
    """

    kind = "thrusters"

    def __init__(self, bus: BusConfig, thrusters: list[tuple[int, ThrusterConfig]]) -> None:
        nodes: dict[int, _Node] = {}
        for index, config in thrusters:
            nodes.setdefault(config.node_id, _Node()).thrusters.append((index, config))
        self._nodes = list(nodes.values())
        first = [node.thrusters[0][1] for node in self._nodes]
        reporters = [
            Reporter(
                own.name,
                own.rate_hz,
                shipped(REPORT, ROLES, COB_TPDO1 | own.node_id),
                own.node_id,
            )
            for own in first
        ]
        self._reports = Reports(bus, reporters, Fault.THRUSTER_SILENT)
        self.words, self.owns = self._reports.words, self._reports.owns
        self.findings = self._reports.findings

    def feed(self, frames: FrameArray) -> DeviceSamples:
        """Accept frames in order, SYNCs among them, and return the states they hold."""
        timed, found = self._reports.read(frames), list[tuple[int, int, int, float, float]]()
        values = timed.values[:, [POSITION, TIME, TORQUE]].astype(np.int64)
        rows = self._reports.good(timed, np.ones(len(values), np.bool_))
        columns = (timed.device, timed.t_ns, timed.done_ns, *values.T)
        for place, latch_ns, done_ns, valves, changes, age in zip(
            *(column[rows].tolist() for column in columns), strict=True
        ):
            age_ns = -1 if age == OLD else age * AGE_SCALE_NS
            found += _states(self._nodes[place], latch_ns, done_ns, valves, changes, age_ns)
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
                "open": float(node.valves >> config.valve & 1),
            }
            for node, counts in zip(self._nodes, self._reports.counts, strict=True)
            for _, config in node.thrusters
        }


def _states(
    node: _Node, latch_ns: int, received_ns: int, valves: int, changes: int, age_ns: int
) -> list[tuple[int, int, int, float, float]]:
    """Return rows of time, receive stamp, thruster, state, is_change; update the node."""
    found = []
    several = (changes - node.changes) % COUNT
    first, known_before = node.latch_ns is None, node.latch_ns or 0
    change_ns = latch_ns - age_ns
    in_gap = change_ns >= known_before - AGE_SCALE_NS  # within the rounding of the age
    clear = several == 0 or (several == 1 and age_ns >= 0 and in_gap)
    for index, config in node.thrusters:
        now, before = valves >> config.valve & 1, node.valves >> config.valve & 1
        if not first and not clear:
            found.append((latch_ns, received_ns, index, float("nan"), 0.0))
        elif not first and now != before:
            found.append((max(change_ns, known_before + 1), received_ns, index, float(now), 1.0))
        found.append((latch_ns, received_ns, index, float(now), 0.0))
    node.latch_ns, node.valves, node.changes = latch_ns, valves, changes
    return found
