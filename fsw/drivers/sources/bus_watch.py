"""Compares answers with SYNCs: finds lost, doubled, late and overtaken frames, and silent nodes.

A SYNC is settled (judged) three SYNCs later, because its answers may be late. If no node answered a
SYNC, the SYNC was lost and not the answers; if most nodes answered twice, the SYNC was doubled.
Delays are counted in SYNCs, so that a late loop finds nothing wrong.

In most batches every node answers every SYNC once, in order and in time. Then nothing can be found,
which a few comparisons of arrays show. Any other batch is judged event by event.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fsw.messages import IntArray
from fsw.messages.findings import Fault, Finding

SETTLE_SYNCS = 3
ESTABLISHED_SYNCS = 50  # a node that answered for longer has started; a later boot-up is a restart
EXCUSED_SYNCS = 50  # the longest silence that a restart explains
REPEAT_S = 0.1  # a silence that continues is reported again after this time
BABBLE_FRAMES_PER_S = 3000.0  # of frames of no configured node: a third of what a bus carries
BABBLE_SYNCS = 3
MAX_FINDINGS = 1024  # kept until `take`; the oldest are discarded
FOREVER = 1 << 62


@dataclass(frozen=True, slots=True, eq=False)
class Answers:
    """Answers of nodes in a batch, in order of arrival; all arrays (k,)."""

    node: IntArray
    sync: IntArray  # running index of the SYNC that each answers; below 0: none found
    newest: IntArray  # running index of the newest SYNC at the answer's arrival
    row: IntArray  # row of the frame in the batch
    t_ns: IntArray


class Mark(NamedTuple):
    """A SYNC, a boot-up message, or a frame of no configured node, in a batch."""

    row: int
    t_ns: int
    sync: int = -1  # running index of the SYNC; -1: no SYNC
    booted: int = -1  # node of the boot-up message; -1: no such message


class _Node:
    __slots__ = ("excused", "first", "name", "newest", "silent_at")

    def __init__(self, name: str) -> None:
        self.name = name
        self.first = 0  # index of the first SYNC answered
        self.newest = -1  # index of the newest SYNC answered; -1: none yet
        self.excused = 0  # missing answers to SYNCs before this one are explained
        self.silent_at = -1  # SYNC at which the node's silence was last reported; -1: not silent

    def is_explained(self, index: int) -> bool:
        """Return whether a restart or a missing port still explains the node's silence."""
        excused = self.excused == FOREVER and self.silent_at < 0
        return excused and index - self.newest < EXCUSED_SYNCS


class BusWatch:
    """Judges the answers of the nodes of one bus.

    Parameters
    ----------
    bus : name of the bus
    names : name of the joint of each node
    rate_hz : rate of SYNC
    silent_syncs : SYNCs without an answer that make a node silent
    late_syncs : an answer this many SYNCs after its own SYNC is late; one SYNC is usual
    """

    def __init__(
        self,
        bus: str,
        names: Mapping[int, str],
        rate_hz: float,
        silent_syncs: float,
        late_syncs: int,
    ) -> None:
        self._bus = bus
        self._nodes = {node: _Node(names[node]) for node in sorted(names)}
        self._silent, self._late = silent_syncs, late_syncs
        self._answers: dict[int, dict[int, int]] = {}
        self._heard = 0  # number of nodes received so far
        self._index = -1  # index of the newest SYNC
        self._bus_silent = False
        self._strangers = 0
        self._repeat = max(1, round(REPEAT_S * rate_hz))
        self._babble_limit = BABBLE_FRAMES_PER_S * BABBLE_SYNCS / rate_hz
        self._found: deque[Finding] = deque(maxlen=MAX_FINDINGS)

    def take(self) -> list[Finding]:
        """Return the findings since the last call, in order of time."""
        found = sorted(self._found, key=lambda finding: finding.t_ns)
        self._found.clear()
        return found

    def find(self, t_ns: int, fault: Fault, node: int | None = None, text: str = "") -> None:
        """Add a finding about a node's joint, or about the bus if `node` is None."""
        subject = self._bus if node is None else self._nodes[node].name
        self._found.append(Finding(t_ns, fault, subject, text))

    def feed(self, answers: Answers, syncs: Sequence[Mark], others: Sequence[Mark]) -> None:
        """Accept a batch: the answers, the SYNCs, and the marks of other frames."""
        if not others and self._is_regular(answers, syncs):
            return
        events: list[tuple[int, int, Mark | tuple[int, int]]]
        events = [(mark.row, -1, mark) for mark in (*syncs, *others)]
        columns = (answers.row, answers.node, answers.sync, answers.t_ns)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        events += [(row, node, (sync, t_ns)) for row, node, sync, t_ns in rows]
        for _, node, event in sorted(events, key=lambda item: item[0]):
            if not isinstance(event, Mark):
                sync, t_ns = event
                if sync < 0:
                    self.answer_of_no_sync(node)
                else:
                    self.answer(node, sync, t_ns)
            elif event.sync >= 0:
                self.sync(event.sync, event.t_ns)
            elif event.booted >= 0:
                self.boot(event.booted, event.t_ns)
            else:
                self.stranger()

    def _is_regular(self, answers: Answers, syncs: Sequence[Mark]) -> bool:
        """Accept a batch in which nothing can be found; else return False and change nothing.

        Every node must have answered each SYNC up to its newest once, so far and in this batch,
        before the third SYNC after it. Then no SYNC is settled without all its answers.
        """
        states, last = self._nodes, syncs[-1].sync if syncs else self._index
        if not states:
            return False
        nodes = np.fromiter(states, np.int64, len(states))
        before = np.array([state.newest for state in states.values()])
        late = answers.newest - answers.sync
        if (
            self._strangers
            or self._bus_silent
            or self._heard < len(states)
            or self._silent < SETTLE_SYNCS
            or (answers.sync < 0).any()
            or (late > min(self._late, SETTLE_SYNCS) - 1).any()
            or any(s.silent_at >= 0 or s.excused == FOREVER for s in states.values())
            or not self._is_settled_so_far()
        ):
            return False
        order = np.argsort(answers.node, kind="stable")
        node, sync = answers.node[order], answers.sync[order]
        first = np.searchsorted(node, nodes)
        stop = np.searchsorted(node, nodes, side="right")
        counts = stop - first
        newest = before + counts
        if counts.sum() != len(node) or (newest < last - SETTLE_SYNCS).any():
            return False
        place = np.arange(len(node)) - np.repeat(first, counts)
        if not np.array_equal(sync, np.repeat(before + 1, counts) + place):
            return False
        self._index = last
        self._answers = {
            k: {n: 1 for n, s in zip(nodes.tolist(), newest.tolist(), strict=True) if s >= k}
            for k in range(max(last - SETTLE_SYNCS + 1, 0), int(newest.max()) + 1)
        }
        for state, index in zip(states.values(), newest.tolist(), strict=True):
            state.newest = index
        return True

    def _is_settled_so_far(self) -> bool:
        """Return whether every node answered each unsettled SYNC up to its newest exactly once."""
        newest = [state.newest for state in self._nodes.values()]
        for index in range(self._index - SETTLE_SYNCS + 1, self._index + 1):
            answers = self._answers.get(index, {})
            if len(answers) != sum(n >= index for n in newest):
                return False
            if len(answers) != sum(answers.values()):
                return False
        return True

    def sync(self, index: int, t_ns: int) -> None:
        """Accept a SYNC and settle the SYNC `SETTLE_SYNCS` before."""
        self._index = index
        self._settle(index - SETTLE_SYNCS, t_ns)
        self._watch_silence(index, t_ns)
        if index % BABBLE_SYNCS == 0:
            if self._strangers > self._babble_limit:
                text = f"{self._strangers} frames of nobody's in {BABBLE_SYNCS} SYNCs"
                self.find(t_ns, Fault.BUS_BABBLE, None, text)
            self._strangers = 0

    def stranger(self) -> None:
        """Count a frame that belongs to no service of a configured node."""
        self._strangers += 1

    def answer(self, node: int, sync: int, t_ns: int) -> None:
        """Record that a node answered a SYNC; the values of the answer may be unusable."""
        state = self._nodes[node]
        answers = self._answers.setdefault(sync, {})
        count = answers.get(node, 0)
        answers[node] = count + 1
        if self._index - sync >= self._late and sync > state.newest:
            self.find(t_ns, Fault.JOINT_LATE, node, f"{self._index - sync} SYNCs behind its own")
        if sync > state.newest:
            if state.newest < 0:
                self._heard += 1
                state.excused = state.first = sync
            elif state.silent_at >= 0 or state.excused == FOREVER:
                state.excused = sync
            state.newest, state.silent_at = sync, -1
            self._bus_silent = False
        elif not count:
            self.find(t_ns, Fault.JOINT_ORDER, node, "overtaken by a newer sample")

    def answer_of_no_sync(self, node: int) -> None:
        """Accept an answer that matches no SYNC; count it as the answer expected next."""
        state = self._nodes[node]
        if state.newest >= 0:
            state.newest = max(state.newest + 1, self._index - 1)
            self._answers.setdefault(state.newest, {})[node] = 1

    def boot(self, node: int, t_ns: int) -> None:
        """Accept a boot-up message; it explains the answers missing until the next one."""
        state = self._nodes[node]
        established = state.newest - state.first >= ESTABLISHED_SYNCS
        if established and state.silent_at < 0:
            self.find(t_ns, Fault.NODE_RESTARTED, node, "boot-up message")
        if state.newest >= 0:
            state.excused = FOREVER

    def without_port(self) -> None:
        """Record that the port is missing; this explains the answers missing until the next one."""
        for state in self._nodes.values():
            if state.newest >= 0:
                state.excused = FOREVER

    def _settle(self, index: int, t_ns: int) -> None:
        answers = self._answers.pop(index, {})
        if len(answers) == self._heard == sum(answers.values()):
            return
        doubled = [node for node, count in answers.items() if count > 1]
        if len(doubled) > max(1, self._heard // 2):
            self.find(t_ns, Fault.SYNC_DOUBLED, None, "its answers came twice")
        else:
            for node in doubled:
                self.find(t_ns, Fault.JOINT_DUPLICATE, node)
        if len(answers) < self._heard:
            self._settle_missing(index, t_ns, answers)
        for old in [key for key in self._answers if key < index]:
            del self._answers[old]  # answers to a SYNC that was settled before

    def _settle_missing(self, index: int, t_ns: int, answers: Mapping[int, int]) -> None:
        lost = [
            node
            for node, state in self._nodes.items()
            if node not in answers and state.excused <= index < state.newest
        ]
        if not answers and len(lost) > 1 and len(lost) == self._heard:
            self.find(t_ns, Fault.SYNC_LOST, None, "no node answered it")
            return
        for node in lost:
            self.find(t_ns, Fault.JOINT_LOST, node)

    def _watch_silence(self, index: int, t_ns: int) -> None:
        missing = [
            (node, state)
            for node, state in self._nodes.items()
            if state.newest >= 0 and index - state.newest > self._silent
        ]
        silent = [(node, state) for node, state in missing if not state.is_explained(index)]
        if not silent:
            return
        whole = len(missing) > 1 and len(missing) == self._heard
        for node, state in silent:
            if state.silent_at >= 0 and index - state.silent_at < self._repeat:
                continue
            first = state.silent_at < 0
            state.silent_at = index
            if not whole:
                text = f"no sample for {index - state.newest} SYNCs" if first else ""
                self.find(t_ns, Fault.JOINT_SILENT, node, text)
        if whole and (not self._bus_silent or index % self._repeat == 0):
            self._bus_silent = True
            self.find(t_ns, Fault.BUS_SILENT, None, "no node answers")
