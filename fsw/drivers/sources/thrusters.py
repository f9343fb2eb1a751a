"""Thruster nodes of one CAN bus: frames to states of valves, timed by the SYNC they echo."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsw.config import BusConfig, ThrusterConfig
from fsw.drivers.codecs import canopen
from fsw.drivers.layout.shipped import AGE_SCALE_NS, OLD, READ_THRUSTER, THRUSTER
from fsw.drivers.sources.counters import Counters
from fsw.drivers.sources.sync import history_of
from fsw.drivers.wire import FrameArray, Reject
from fsw.messages import DeviceSamples
from fsw.messages.findings import Fault, Finding

SILENT_REPORTS = 5.0  # a node without a report for longer than this many periods is silent
STATUS_OF_VALVES = 0xD8  # valves valid, driver fault, SYNC lost, test data
STATUS_VALVES_VALID = 0x08
OWN_SERVICES = (canopen.COB_TPDO1, canopen.COB_SYNC, canopen.COB_HEARTBEAT)
COUNT = 256  # modulus of the counter of changes


@dataclass(slots=True)
class _Node:
    """One valve driver and its newest report."""

    rate_hz: float
    thrusters: list[tuple[int, ThrusterConfig]]  # index in the configured list
    counts: Counters
    latch_ns: int | None = None  # latch time of the newest report
    heard_ns: int | None = None  # likewise, of reports that have no time because SYNC has crept too
    valves: int = 0
    changes: int = 0


class ThrusterBusSource:
    """Every thruster node of one bus.

    A report is valid at the stamp of the SYNC whose counter it echoes plus the latch offset. It
    gives the valves' states at this time and the time of the newest change. If more than one
    change lies between two reports, as after lost reports, a NaN marks the unknown changes.
    """

    kind = "thrusters"

    words: tuple[int, ...] = ()  # of frames that begin the grid of windows: a SYNC does

    def __init__(self, bus: BusConfig, thrusters: list[tuple[int, ThrusterConfig]]) -> None:
        self._nodes: dict[int, _Node] = {}
        for index, config in thrusters:
            node = self._nodes.setdefault(config.node_id, _Node(config.rate_hz, [], Counters()))
            node.thrusters.append((index, config))
        self._bus = bus.name
        self._found: list[Finding] = []
        self._syncs = history_of(bus)
        self._latch_offset_ns = round(bus.latch_offset_s * 1e9)
        self._now_ns = 0

    def owns(self, frames: FrameArray) -> NDArray[np.bool_]:
        """Return (k,) which frames belong to thruster nodes only; a SYNC does not."""
        words = frames["word"]
        own = (words <= canopen.COB_HEARTBEAT | canopen.NODE_MASK) & (words > canopen.COB_SYNC)
        own &= np.isin(words & canopen.NODE_MASK, list(self._nodes))
        own &= np.isin(words & ~np.uint32(canopen.NODE_MASK), OWN_SERVICES)
        return np.asarray(own, np.bool_)

    def feed(self, frames: FrameArray) -> DeviceSamples:
        """Accept frames in order, SYNCs among them, and return the states they hold."""
        words = frames["word"]
        self._now_ns = self._syncs.note(frames) or self._now_ns
        is_report = words & ~np.uint32(canopen.NODE_MASK) == canopen.COB_TPDO1
        rows = np.flatnonzero(is_report & np.isin(words & canopen.NODE_MASK, list(self._nodes)))
        own, found = frames.take(rows), list[tuple[int, int, int, float, float]]()
        t_ns = own["t_ns"].astype(np.int64)
        valves, age, changes, status, counter = READ_THRUSTER(own["data"])
        age_ns = np.where(age == OLD, -1, age * AGE_SCALE_NS)
        index, sync_ns, _, crept = self._syncs.match(counter, rows, t_ns)
        usable = status & STATUS_OF_VALVES == STATUS_VALVES_VALID
        for k, length in enumerate(own["length"].tolist()):
            node = self._nodes[int(own["word"][k]) & canopen.NODE_MASK]
            latch_ns = int(sync_ns[k]) + self._latch_offset_ns
            reason = next(
                (
                    why
                    for bad, why in (
                        (length != THRUSTER.length, Reject.LENGTH),
                        (index[k] < 0 or crept[k], Reject.STALE),
                        (not usable[k], Reject.STATUS),
                        (node.latch_ns is not None and latch_ns <= node.latch_ns, Reject.SEQUENCE),
                    )
                    if bad
                ),
                None,
            )
            node.counts.received_bytes += length
            if crept[k]:
                node.heard_ns, text = latch_ns, self._syncs.movement
                self._found.append(Finding(int(t_ns[k]), Fault.SYNC_CREEPS, self._bus, text))
            if reason is not None:
                node.counts.reject(reason, length)
                continue
            node.counts.accepted += 1
            node.counts.accepted_bytes += length
            state = int(valves[k]), int(changes[k]), int(age_ns[k])
            found += _states(node, latch_ns, int(t_ns[k]), *state)
        columns = np.array(found, np.float64).reshape(-1, 5)
        times = np.array([row[:2] for row in found], np.int64).reshape(-1, 2)
        return DeviceSamples(
            section=self.kind,
            t_ns=times[:, 0],
            t_receive_ns=times[:, 1],
            device=columns[:, 2].astype(np.int64),
            values=columns[:, 3:],
        )

    def findings(self) -> list[Finding]:
        """Return the findings since the last call, and one for every silent node."""
        found, self._found = self._found, []
        for node in self._nodes.values():
            if node.heard_ns is None:
                continue
            age_s = (self._now_ns - node.heard_ns) * 1e-9
            if age_s * node.rate_hz > SILENT_REPORTS:
                text, subject = f"no report for {age_s:.1f} s", node.thrusters[0][1].name
                found.append(Finding(self._now_ns, Fault.THRUSTER_SILENT, subject, text))
        return found

    def status(self) -> dict[str, dict[str, Any]]:
        """Return the newest state of every thruster and its node's counters, by name."""
        return {
            config.name: {
                "accepted": node.counts.accepted,
                "rejected": node.counts.rejected,
                "open": float(node.valves >> config.valve & 1),
            }
            for node in self._nodes.values()
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
    node.heard_ns = latch_ns
    return found
