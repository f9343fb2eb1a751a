"""Which cue a reply answers: a device answers cues in order, each with one reply or none.

So a reply behind cues that all have a reply answers the last one. Where one has none, that reply is
lost, or it comes late: a busy machine holds replies for some periods and then delivers all of them.
The count tells. Replies i to j, the last cues before which are a_i to a_j, have the numbers
n_i = min(a_i, n_(i+1) - 1), n_j = a_j. A reply is held until its number cannot become less, which
is when it follows that of the reply before, or until no more is expected to come. Then the missing
one is lost; but where another device was late just then, the reply is refused: it may be late too.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.drivers.sources.cues import FOREVER_NS, HELD, Cues
from fsw.drivers.sources.groups import Group
from fsw.drivers.sources.validity import REFUSED
from fsw.messages import IntArray

PATIENCE_NS = 80_000_000  # a reply that is missing for so long is lost


class Answered(NamedTuple):
    """Samples by device, in order; all arrays (k,)."""

    device: IntArray
    group: Group
    number: IntArray  # of the cue, REFUSED if the sample answers none that is known
    t_ns: IntArray  # stamp of the cue


class Replies:
    """Finds the cues of the samples of devices that measure at a cue.

    Parameters
    ----------
    cues : what makes the devices measure
    owns : (devices,) which devices
    latest_ns : (devices,) a sample sent later after its cue is refused
    each : (devices,) whether the device answers each cue; the others answer the last one before
    """

    def __init__(
        self, cues: Cues, owns: NDArray[np.bool_], latest_ns: IntArray, each: NDArray[np.bool_]
    ) -> None:
        self.owns = owns
        self._cues, self._latest_ns, self._each = cues, latest_ns, each
        self._newest = np.full(len(each), REFUSED)  # number of the newest sample, by device
        self._device = np.empty(0, np.int64)
        self._held: Group | None = None
        self._late: dict[int, int] = {}  # cues followed by late samples: when this was known [ns]

    def feed(self, device: IntArray, group: Group) -> Answered:
        """Accept the samples of a batch, sorted by device; return those whose cue is found.

        A sample that was held is done (`done_ns`) with the frame that told its cue.
        """
        if self._held is not None:
            device = np.concatenate([self._device, device])
            group = Group(*(np.concatenate(pair) for pair in zip(self._held, group, strict=True)))
            order = np.argsort(device, kind="stable")
            device, group, self._held = device[order], group.part(order), None
        number = self._cues.last(group.sent_ns)
        heads = np.flatnonzero(np.diff(device, prepend=-1))
        before = np.roll(number, 1)
        before[heads] = self._newest[device[heads]]
        if not ((number == before + 1) | ~self._each[device]).all():
            device, group, number = self._decided(device, group, number, heads)
        else:
            ends = np.flatnonzero(np.diff(device, append=len(self._each)))
            self._newest[device[ends]] = number[ends]
        t_ns = self._cues.stamps_ns(number)
        is_late = group.sent_ns - t_ns > self._latest_ns[device]
        return Answered(device, group, np.where(is_late, REFUSED, number), t_ns)

    def _decided(
        self, device: IntArray, group: Group, last: IntArray, heads: IntArray
    ) -> tuple[IntArray, Group, IntArray]:
        """Return the samples whose cue is found, with its number; hold the others."""
        number, done_ns = last.copy(), group.done_ns.copy()
        is_held, is_doubted = np.zeros((2, len(device)), np.bool_)
        for start, stop in zip(heads.tolist(), [*heads[1:].tolist(), len(device)], strict=True):
            place, own = int(device[start]), slice(start, stop)
            if not self._each[place]:
                continue
            columns = (column[own].tolist() for column in (last, group.sent_ns, group.done_ns))
            found = self._found(int(self._newest[place]), *columns)
            for row, one in enumerate(found, start):
                number[row], done_ns[row], is_doubted[row] = one
            is_held[start + len(found) : stop] = True
            self._newest[place] = found[-1][0] if found else self._newest[place]
        is_late = ~is_held & (number < last) & self._each[device]
        for cue, known_ns in zip(last[is_late].tolist(), done_ns[is_late].tolist(), strict=True):
            self._late[cue] = min(self._late.get(cue, FOREVER_NS), known_ns)
        for row in np.flatnonzero(is_doubted).tolist():
            if self._late.get(int(last[row]), FOREVER_NS) <= done_ns[row]:
                number[row] = REFUSED
        self._late = {cue: t for cue, t in self._late.items() if cue > self._cues.count - HELD}
        if is_held.any():
            self._device, self._held = device[is_held], group.part(is_held)
        group = group._replace(done_ns=done_ns)
        return device[~is_held], group.part(~is_held), number[~is_held]

    def _found(
        self, newest: int, last: list[int], sent_ns: list[int], done_ns: list[int]
    ) -> list[tuple[int, int, bool]]:
        """Return number, time of being known, and whether the count leaves a doubt.

        These are of the first samples of a device; the others are to be held.
        """
        found = list[tuple[int, int, bool]]()
        for count in range(1, len(last) + 1):
            known_ns, is_over = done_ns[count - 1], False
            until_ns = done_ns[count] if count < len(last) else FOREVER_NS
            while (first := len(found)) < count:
                number = min(last[k] + first - k for k in range(first, count))
                if number > newest + 1:
                    over_ns = self._cues.first_ns(sent_ns[first] + PATIENCE_NS)
                    if over_ns >= until_ns:
                        break
                    known_ns, is_over = max(known_ns, over_ns), True
                newest = max(newest, number)
                found.append((newest, known_ns, is_over))
        return found


def answered(replies: Sequence[Replies], device: IntArray, group: Group) -> Answered:
    """Return the samples, sorted by device; those of devices without cues have no number yet."""
    parts, is_other = list[Answered](), np.ones(len(device), np.bool_)
    for some in replies:
        own = some.owns[device]
        parts.append(some.feed(device[own], group.part(own)))
        is_other &= ~own
    if len(parts) == 1 and not is_other.any():
        return parts[0]
    others = group.part(is_other)
    none = np.full(len(others.sent_ns), REFUSED)
    parts.append(Answered(device[is_other], others, none, others.sent_ns.copy()))
    order = np.argsort(np.concatenate([part.device for part in parts]), kind="stable")
    groups = zip(*(part.group for part in parts), strict=True)
    device, number, t_ns = (np.concatenate([part[k] for part in parts])[order] for k in (0, 2, 3))
    return Answered(device, Group(*map(np.concatenate, groups)).part(order), number, t_ns)
