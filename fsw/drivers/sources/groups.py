"""Samples that are spread over several frames: which frames of a device make one sample."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.messages import FloatArray, IntArray


class Arrivals(NamedTuple):
    """Frames of one device in order of arrival; all arrays (k,), `values` (k, roles)."""

    member: IntArray  # which of the device's messages
    t_ns: IntArray
    row: IntArray  # in the batch
    values: FloatArray  # NaN: not in this frame
    done_ns: IntArray  # when its cue was known
    number: IntArray  # of the cue that it answers, REFUSED if it answers none that is known
    cue_ns: IntArray  # stamp of the cue; that of the frame if nothing is the device's cue

    def part(self, rows: slice | NDArray[np.intp] | NDArray[np.bool_]) -> "Arrivals":
        """Return some of the frames."""
        return Arrivals._make(column[rows] for column in self)


class _Frame(NamedTuple):
    """One row of `Arrivals`, or of a whole sample."""

    member: int
    t_ns: int
    row: int
    values: FloatArray
    done_ns: int
    number: int
    cue_ns: int


class Group(NamedTuple):
    """Samples in order; all arrays (k,), `values` (k, roles)."""

    sent_ns: IntArray  # stamp of the frame that counts as the time
    sent_row: IntArray  # its row in the batch; -1: in an earlier one
    values: FloatArray
    done_ns: IntArray  # when the last frame of the sample had come and its cue was known
    number: IntArray  # as that of frames
    cue_ns: IntArray


class Groupings:
    """Joins the frames of every device of a bus to samples.

    Parameters
    ----------
    devices : number of messages of each device's sample, and the longest time between them [ns];
        None: however long, they answer the same cue
    """

    def __init__(self, devices: Sequence[tuple[int, int | None]]) -> None:
        self._each = [Grouping(*own) for own in devices]
        members = {own[0] for own in devices}
        self._members = members.pop() if len(members) == 1 else 0  # 0: they differ
        self._by_cue = np.array([own[1] is None for own in devices])
        self._spread_ns = np.array([own[1] or 0 for own in devices])

    @property
    def headless(self) -> int:
        """Number of samples without the message that carries the time."""
        return sum(own.headless for own in self._each)

    def feed(self, device: IntArray, frames: Arrivals) -> tuple[IntArray, Group]:
        """Accept frames of one batch, sorted by device (k,); return devices and samples."""
        if self._members == 1 or self._is_regular(device, frames):
            return device[:: self._members], _whole(frames, self._members)
        bounds = np.searchsorted(device, np.arange(len(self._each) + 1)).tolist()
        parts = [
            own.feed(frames.part(slice(start, stop)))
            for own, (start, stop) in zip(self._each, pairwise(bounds), strict=True)
        ]
        counts = [len(part.sent_ns) for part in parts]
        whole = Group(*(np.concatenate(column) for column in zip(*parts, strict=True)))
        return np.repeat(np.arange(len(counts)), counts), whole

    def _is_regular(self, device: IntArray, frames: Arrivals) -> bool:
        """Return whether the frames are whole samples, one after the other."""
        size = self._members
        if not size or len(device) % size or any(own.is_open for own in self._each):
            return False
        own = device[::size]
        is_of_one = np.array_equal(own, device[size - 1 :: size])
        return is_of_one and _are_whole(frames, size, self._spread_ns[own], self._by_cue[own])


def _are_whole(
    frames: Arrivals, members: int, spread_ns: int | IntArray, by_cue: bool | NDArray[np.bool_]
) -> bool:
    """Return whether each `members` frames after the other are a sample; one limit, or one each."""
    if len(frames.t_ns) % members:
        return False
    member, t_ns, number = (column.reshape(-1, members) for column in (*frames[:2], frames.number))
    is_near = np.where(by_cue, np.ptp(number, axis=1) == 0, np.ptp(t_ns, axis=1) <= spread_ns)
    return bool(is_near.all() and (np.sort(member, axis=1) == np.arange(members)).all())


def _whole(frames: Arrivals, members: int) -> Group:
    """Return samples of which every message has come, one after the other."""
    if members == 1:
        return Group(*frames[1:])
    values = frames.values.reshape(-1, members, frames.values.shape[1])
    merged = values[:, 0].copy()
    for k in range(1, members):
        np.copyto(merged, values[:, k], where=np.isnan(merged))
    _, t_ns, row, _, _, number, cue_ns = frames.part(np.flatnonzero(frames.member == 0))
    return Group(t_ns, row, merged, frames.done_ns[members - 1 :: members], number, cue_ns)


class Grouping:
    """Joins the frames of one device to samples.

    A sample begins with its first frame. It ends when all its messages have come, when one comes
    again or answers another cue, or after `spread_ns`. Member 0 carries the sample's time. A sample
    without it is dropped and counted in `headless`; one that lacks another member has NaN there.
    """

    def __init__(self, members: int, spread_ns: int | None) -> None:
        self._members, self._spread_ns = members, spread_ns
        self._open: list[_Frame] = []
        self.headless = 0

    @property
    def is_open(self) -> bool:
        """Whether frames wait for others of their sample."""
        return bool(self._open)

    def feed(self, frames: Arrivals) -> Group:
        """Accept frames of one batch; return the samples that they complete."""
        spread_ns, by_cue = self._spread_ns or 0, self._spread_ns is None
        if not self._open and _are_whole(frames, self._members, spread_ns, by_cue):
            return _whole(frames, self._members)
        self._open, found = [own._replace(row=-1) for own in self._open], list[_Frame]()
        columns = (column if column.ndim > 1 else column.tolist() for column in frames)
        for own in map(_Frame._make, zip(*columns, strict=True)):
            if self._open and self._is_apart(own):
                self._close(own.done_ns, found)
            self._open.append(own)
            if len(self._open) == self._members:
                self._close(own.done_ns, found)
        if not found:
            return Group(*frames.part(slice(0))[1:])
        return Group(*map(np.array, list(zip(*found, strict=True))[1:]))

    def _is_apart(self, own: _Frame) -> bool:
        """Return whether a frame begins another sample."""
        first = self._open[0]
        if any(other.member == own.member for other in self._open):
            return True
        if self._spread_ns is None:
            return own.number != first.number
        return own.t_ns - first.t_ns > self._spread_ns

    def _close(self, done_ns: int, found: list[_Frame]) -> None:
        """Append the open sample, which is known at `done_ns`; nothing if it has no head."""
        held, self._open = self._open, []
        head = next((own for own in held if own.member == 0), None)
        if head is None:
            self.headless += 1
            return
        merged = held[0].values.copy()
        for own in held[1:]:
            np.copyto(merged, own.values, where=np.isnan(merged))
        found.append(head._replace(values=merged, done_ns=done_ns))
