"""Samples that are spread over several frames: which frames of a device make one sample."""

from collections.abc import Sequence
from itertools import pairwise
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

    def part(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> "Group":
        """Return some of the samples."""
        sent_ns, sent_row, done_ns, values = self
        return Group(sent_ns[rows], sent_row[rows], done_ns[rows], values[rows])


class Groupings:
    """Puts the frames of all joints of a bus together.

    Parameters
    ----------
    joints : number of messages of each joint's sample, and the longest time between them [ns]
    """

    def __init__(self, joints: Sequence[tuple[int, int]]) -> None:
        self._each = [Grouping(*own) for own in joints]
        members = {own[0] for own in joints}
        self._members = members.pop() if len(members) == 1 else 0  # 0: not the same of all
        self._spread_ns = np.array([own[1] for own in joints])

    @property
    def headless(self) -> int:
        """Number of samples without the message that carries the time."""
        return sum(own.headless for own in self._each)

    def feed(self, joint: IntArray, frames: Arrivals) -> tuple[IntArray, Group]:
        """Accept frames of one batch, sorted by joint (k,); return joints and samples."""
        if self._is_regular(joint, frames):
            return joint[:: self._members], _whole(frames, self._members)
        bounds = np.searchsorted(joint, np.arange(len(self._each) + 1)).tolist()
        parts = [
            own.feed(frames.part(slice(start, stop)))
            for own, (start, stop) in zip(self._each, pairwise(bounds), strict=True)
        ]
        counts = [len(part.sent_ns) for part in parts]
        whole = Group(*(np.concatenate(column) for column in zip(*parts, strict=True)))
        return np.repeat(np.arange(len(counts)), counts), whole

    def _is_regular(self, joint: IntArray, frames: Arrivals) -> bool:
        """Return whether the frames are whole samples, one after the other."""
        size = self._members
        if not size or len(joint) % size or any(own.is_open for own in self._each):
            return False
        joints = joint.reshape(-1, size)
        is_of_one = bool((joints[:, 0] == joints[:, -1]).all())
        return is_of_one and _are_whole(frames, size, self._spread_ns[joints[:, 0]])


def _are_whole(frames: Arrivals, members: int, spread_ns: int | IntArray) -> bool:
    """Return whether each `members` frames after the other are a sample; one limit, or one each."""
    if members == 1 or len(frames.t_ns) % members:
        return members == 1
    member, t_ns = frames.member.reshape(-1, members), frames.t_ns.reshape(-1, members)
    is_whole = bool((np.sort(member, axis=1) == np.arange(members)).all())
    return is_whole and bool((np.ptp(t_ns, axis=1) <= spread_ns).all())


def _whole(frames: Arrivals, members: int) -> Group:
    """Return samples of which every message has come, one after the other."""
    if members == 1:
        return Group(frames.t_ns, frames.row, frames.t_ns, frames.values)
    values = frames.values.reshape(-1, members, frames.values.shape[1])
    merged = values[:, 0].copy()
    for k in range(1, members):
        np.copyto(merged, values[:, k], where=np.isnan(merged))
    heads = np.flatnonzero(frames.member == 0)
    return Group(frames.t_ns[heads], frames.row[heads], frames.t_ns[members - 1 :: members], merged)


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

    @property
    def is_open(self) -> bool:
        """Whether frames wait for others of their sample."""
        return bool(self._open)

    def feed(self, frames: Arrivals) -> Group:
        """Accept frames of one batch; return the samples that they complete."""
        if not self._open and _are_whole(frames, self._members, self._spread_ns):
            return _whole(frames, self._members)
        self._open = [(member, t_ns, -1, values) for member, t_ns, _, values in self._open]
        none = np.empty(0, np.int64)
        parts = [Group(none, none, none, np.empty((0, frames.values.shape[1])))]
        columns = zip(*(own.tolist() for own in frames[:3]), frames.values, strict=True)
        for member, t_ns, row, values in columns:
            parts += self._add(member, t_ns, row, values)
        return Group(*(np.concatenate(column) for column in zip(*parts, strict=True)))

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
