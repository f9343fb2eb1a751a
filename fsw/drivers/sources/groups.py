"""Samples that are spread over several frames: which frames of a device make one sample."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.messages import FloatArray, IntArray


class Arrivals(NamedTuple):
    """Frames of one joint in order of arrival; all arrays (k,), `values` (k, roles)."""

    member: IntArray  # which of the joint's messages
    t_ns: IntArray
    row: IntArray  # in the batch
    values: FloatArray  # NaN: not in this frame

    def part(self, rows: slice | NDArray[np.intp]) -> "Arrivals":
        """Return some of the frames."""
        return Arrivals(self.member[rows], self.t_ns[rows], self.row[rows], self.values[rows])


class Group(NamedTuple):
    """Samples in order; all arrays (k,), `values` (k, roles)."""

    sent_ns: IntArray  # stamp of the frame that counts as the time
    sent_row: IntArray  # its row in the batch; -1: in an earlier one
    done_ns: IntArray  # stamp of the last frame of the sample
    values: FloatArray


class Grouping:
    """Puts the frames of one joint together.

    Frames belong to one sample from its first frame on until all its messages have come, one comes
    again, or `spread_ns` is over. Member 0 carries the sample's time. A sample without it is
    dropped and counted in `headless`; a sample that lacks another member has NaN there.
    """

    def __init__(self, members: int, spread_ns: int) -> None:
        self._members, self._spread_ns = members, spread_ns
        self._open: list[tuple[int, int, int, FloatArray]] = []  # member, stamp, row, values
        self.headless = 0

    def feed(self, frames: Arrivals) -> Group:
        """Accept frames of one batch; return the samples that they complete."""
        if self._members == 1:
            return Group(frames.t_ns, frames.row, frames.t_ns, frames.values)
        self._open = [(member, t_ns, -1, values) for member, t_ns, _, values in self._open]
        parts: list[Group] = []
        at, size = 0, len(frames.t_ns)
        while at < size:
            count = 0 if self._open else self._regular(frames, at)
            if count:
                parts.append(self._whole(frames.part(slice(at, at + count * self._members))))
                at += count * self._members
            stop = min(size, at + 4 * self._members)  # then search for regular samples again
            for k in range(at, stop):
                parts += self._add(
                    int(frames.member[k]), int(frames.t_ns[k]), int(frames.row[k]), frames.values[k]
                )
            at = stop
        if not parts:
            none = np.empty(0, np.int64)
            return Group(none, none, none, np.empty((0, frames.values.shape[1])))
        return Group(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def _regular(self, frames: Arrivals, at: int) -> int:
        """Return how many samples from `at` on come whole and in one order of the messages."""
        count = (len(frames.t_ns) - at) // self._members
        if not count:
            return 0
        stop = at + count * self._members
        member = frames.member[at:stop].reshape(count, -1)
        t_ns = frames.t_ns[at:stop].reshape(count, -1)
        if len(set(member[0].tolist())) < self._members:
            return 0
        good = (member == member[0]).all(axis=1) & (t_ns[:, -1] - t_ns[:, 0] <= self._spread_ns)
        return count if good.all() else int(np.argmin(good))

    def _whole(self, frames: Arrivals) -> Group:
        """Return samples of which every message has come, in one order."""
        order = frames.member[: self._members].tolist()
        head = order.index(0)
        values = frames.values.reshape(-1, self._members, frames.values.shape[1])
        merged = values[:, 0].copy()
        for k in range(1, self._members):
            np.copyto(merged, values[:, k], where=np.isnan(merged))
        step = self._members
        return Group(
            frames.t_ns[head::step], frames.row[head::step], frames.t_ns[step - 1 :: step], merged
        )

    def _add(self, member: int, t_ns: int, row: int, values: FloatArray) -> list[Group]:
        found: list[Group] = []
        held = self._open
        if held and (any(own[0] == member for own in held) or t_ns - held[0][1] > self._spread_ns):
            found += self._close(t_ns)
        self._open.append((member, t_ns, row, values))
        if len(self._open) == self._members:
            found += self._close(t_ns)
        return found

    def _close(self, done_ns: int) -> list[Group]:
        """Return the open sample, which is known at `done_ns`; nothing if it has no head."""
        held, self._open = self._open, []
        head = next((own for own in held if own[0] == 0), None)
        if head is None:
            self.headless += 1
            return []
        merged = held[0][3].copy()
        for own in held[1:]:
            np.copyto(merged, own[3], where=np.isnan(merged))
        sent_ns, sent_row, done = (np.array([value]) for value in (head[1], head[2], done_ns))
        return [Group(sent_ns, sent_row, done, merged[None])]
