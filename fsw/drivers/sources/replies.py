"""Which cue a message answers: a device answers cues in order, each with every message or none.

So a message behind cues that all have an answer answers the last one. Where one has none, its
answer is lost, or it comes late: a busy machine holds messages for some periods and then delivers
all of them, in order. Counting decides. Messages i to j, the last cues before which are a_i to a_j,
answer the cues n_i = min(a_i, n_(i+1) - d), n_j = a_j. The step d is 1 from one message to the same
again. To another one it is 1 if the first has always come after the second in an answer, else 0.
Likewise n_i is at least n_(i-1) + d. A message is held until the two bounds are one, or until no
more is expected to come. Then the missing one is lost; but where another device was late just then,
the message is refused: it may be late too.
"""

import numpy as np
from numpy.typing import NDArray

from fsw.drivers.sources.cues import FOREVER_NS, HELD, Cues
from fsw.drivers.sources.groups import Arrivals
from fsw.drivers.sources.validity import REFUSED
from fsw.messages import IntArray

PATIENCE_NS = 80_000_000  # a message that is missing for so long is lost


class Replies:
    """Finds the cues of the messages of devices that measure at a cue.

    Parameters
    ----------
    cues : what makes the devices measure
    owns : (devices,) whether the device measures at these cues
    each : (devices,) whether the device answers each cue; the others answer the last one before
    members : most messages of a device's sample
    """

    def __init__(
        self, cues: Cues, owns: NDArray[np.bool_], each: NDArray[np.bool_], members: int
    ) -> None:
        count = len(owns)
        self._cues, self._owns, self._each, self._members = cues, owns, each, members
        self._newest = np.full((count, members), REFUSED)  # cue of the newest message of each kind
        self._last = np.zeros(count, np.int64)  # kind of the newest message
        self._after = np.zeros((count, members, members), np.bool_)  # [i, j]: i came after j
        self._device = np.empty(0, np.int64)
        self._held: Arrivals | None = None
        self._late: dict[int, int] = {}  # cues followed by late messages: when this was known [ns]

    def date(self, device: IntArray, frames: Arrivals) -> tuple[IntArray, Arrivals]:
        """Accept the frames of a batch, sorted by device; return those whose cue is found.

        `done_ns` of a frame that was held is that of the frame which decided its cue. Frames of
        other devices are returned as they are.
        """
        if self._held is not None:
            device = np.concatenate([self._device, device])
            pairs = zip(self._held, frames, strict=True)
            order = np.argsort(device, kind="stable")
            device, frames = device[order], Arrivals._make(map(np.concatenate, pairs)).part(order)
            self._held = None
        own = np.flatnonzero(self._owns[device])
        last = self._cues.last(frames.t_ns[own])
        frames.number[own] = last
        if not self._follow(device[own], frames.member[own], last):
            device, frames = self._decided(device, frames, own)
            own = np.flatnonzero(self._owns[device])
        frames.cue_ns[own] = self._cues.stamps_ns(frames.number[own])
        return device, frames

    def _follow(self, device: IntArray, member: IntArray, last: IntArray) -> bool:
        """Accept messages if each answers the cue after that of the one before of its kind."""
        kind = device * self._members + member
        order = np.argsort(kind, kind="stable") if self._members > 1 else slice(None)
        kinds, number, newest = kind[order], last[order], self._newest.ravel()
        before, heads = np.roll(number, 1), np.flatnonzero(np.diff(kinds, prepend=-1))
        before[heads] = newest[kinds[heads]]
        if not ((number == before + 1) | ~self._each[device[order]]).all():
            return False
        if self._members > 1:
            self._learn(device, member, last)
        ends = np.flatnonzero(np.diff(kinds, append=-1))
        newest[kinds[ends]] = number[ends]
        return True

    def _learn(self, device: IntArray, member: IntArray, number: IntArray) -> None:
        """Note which message of an answer comes after which."""
        heads = np.flatnonzero(np.diff(device, prepend=-1))
        before, its_number = np.roll(member, 1), np.roll(number, 1)
        before[heads] = self._last[device[heads]]
        its_number[heads] = self._newest[device[heads], before[heads]]
        same = (its_number == number) & (number != REFUSED)
        self._after[device[same], member[same], before[same]] = True
        ends = np.flatnonzero(np.diff(device, append=-1))
        self._last[device[ends]] = member[ends]

    def _decided(
        self, device: IntArray, frames: Arrivals, own: NDArray[np.intp]
    ) -> tuple[IntArray, Arrivals]:
        """Return the frames whose cue is found, with its number; hold the others."""
        last, number, done_ns = frames.number.copy(), frames.number, frames.done_ns.copy()
        is_held, is_doubted = np.zeros((2, len(device)), np.bool_)
        counted = own[self._each[device[own]]]
        for rows in np.split(counted, np.flatnonzero(np.diff(device[counted])) + 1):
            found = self._found(int(device[rows[0]]), frames.part(rows)) if rows.size else []
            for row, one in zip(rows.tolist(), found, strict=False):
                number[row], done_ns[row], is_doubted[row] = one
            is_held[rows[len(found) :]] = True
        is_late = np.zeros(len(device), np.bool_)
        is_late[counted] = ~is_held[counted] & (number < last)[counted]
        for cue, known_ns in zip(last[is_late].tolist(), done_ns[is_late].tolist(), strict=True):
            self._late[cue] = min(self._late.get(cue, FOREVER_NS), known_ns)
        for row in np.flatnonzero(is_doubted).tolist():
            if self._late.get(int(last[row]), FOREVER_NS) <= done_ns[row]:
                number[row] = REFUSED
        self._late = {cue: t for cue, t in self._late.items() if cue > self._cues.count - HELD}
        if is_held.any():
            self._device, self._held = device[is_held], frames.part(is_held)
        return device[~is_held], frames._replace(done_ns=done_ns).part(~is_held)

    def _found(self, device: int, frames: Arrivals) -> list[tuple[int, int, bool]]:
        """Return number, time of being known, and whether the count leaves a doubt.

        These are of the first messages of a device; the others are to be held.
        """
        columns = (frames.member, frames.number, frames.t_ns, frames.done_ns)
        member, last, sent_ns, done_ns = (column.tolist() for column in columns)
        newest, found = self._newest[device], list[tuple[int, int, bool]]()
        row: _Row | None = None
        for count in range(1, len(last) + 1):
            known_ns, is_over = done_ns[count - 1], False
            until_ns = done_ns[count] if count < len(last) else FOREVER_NS
            if row is not None:
                row.add(member[count - 1], last[count - 1])
            while (first := len(found)) < count:
                if row is None or row.least > row.most:
                    row = self._row(device, member[first:count], last[first:count])
                if row.most > row.least:
                    over_ns = self._cues.first_ns(sent_ns[first] + PATIENCE_NS)
                    if over_ns >= until_ns:
                        break
                    known_ns, is_over = max(known_ns, over_ns), True
                own, before = member[first], self._last[device]
                number, row = max(int(newest[own]), row.most), None
                if not is_over and number == last[first] == newest[before] != REFUSED:
                    self._after[device, own, before] = True
                newest[own], self._last[device] = number, own
                found.append((number, known_ns, is_over))
        return found

    def _row(self, device: int, member: list[int], last: list[int]) -> "_Row":
        """Return a device's messages that wait, in the order that it has kept so far, or in any."""
        after, same = self._after[device], np.eye(self._members, dtype=np.bool_)
        newest = self._newest[device].tolist()
        row = _Row((same | (after.T & ~after)).tolist(), newest, member, last)
        return row if row.least <= row.most else _Row(same.tolist(), newest, member, last)


class _Row:
    """Messages in a row: the least and the largest cue that the first of them may answer.

    Parameters
    ----------
    steps : [i][j] least number of cues from a message j to a later i
    newest : cue of the newest message before, of each kind
    member, last : kind of each message, and the last cue before it
    """

    def __init__(
        self, steps: list[list[int]], newest: list[int], member: list[int], last: list[int]
    ) -> None:
        first, self._steps = member[0], steps
        self.least = max(cue + step for cue, step in zip(newest, steps[first], strict=True))
        self.most = last[0]
        self._far = [-FOREVER_NS] * len(steps)  # least number of cues to the newest of each kind
        self._far[first] = 0
        for pair in zip(member[1:], last[1:], strict=True):
            self.add(*pair)

    def add(self, member: int, last: int) -> None:
        """Accept the next message."""
        far = max(far + step for far, step in zip(self._far, self._steps[member], strict=True))
        self._far[member], self.most = far, min(self.most, last - far)
