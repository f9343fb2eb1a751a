"""Frames of described devices: which message is whose, decoded layout by layout."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.drivers.layout.decoder import Decoder
from fsw.drivers.layout.joints import TIME, TORQUE, Layout, Part
from fsw.drivers.sources.groups import Arrivals
from fsw.drivers.sources.validity import REFUSED
from fsw.drivers.wire import MAX_DATA_BYTES, FrameArray
from fsw.messages import IntArray

_Slot = tuple[int, int, Part]  # device, which of its parts
_Short = tuple[int, int, int]  # device, stamp [ns] and bytes of a frame of a wrong length


class _Kind(NamedTuple):
    """Messages of one layout, which are decoded together; rows of the tables are messages."""

    decoder: Decoder
    roles: list[int]  # of the decoded signals
    factors: list[float]
    slots: list[range]  # the decoded signals that one device uses
    pages: list[int | None]  # place of a value that is NaN in frames of other pages
    words: NDArray[np.uint32]
    lengths: IntArray  # least number of bytes in a frame
    most: IntArray
    devices: IntArray  # (messages, slots) place of the device
    members: IntArray  # (messages, slots) which of the device's parts this is


class FrameReader:
    """Reads the frames of all described devices of a bus."""

    def __init__(self, layouts: Sequence[Layout]) -> None:
        self._kinds = _kinds_of(layouts)
        words = [kind.words for kind in self._kinds]
        self.words: NDArray[np.uint32] = np.concatenate(words)
        roles = [use.role for layout in layouts for use in layout.uses]
        self._width = 1 + max(TORQUE, *roles)

    def read(
        self, frames: FrameArray, words: NDArray[np.uint32]
    ) -> tuple[IntArray, Arrivals, list[_Short]]:
        """Return the frames of every device, sorted by device and in order.

        Returns
        -------
        device : (k,) place of the device in the list of layouts
        arrivals : values in SI units; device times are as on the wire
        short : frames that are shorter than their message, or longer than it may be
        """
        none = np.empty(0, np.int64)
        devices, short = [none], list[_Short]()
        parts = [(none, none, none, np.empty((0, self._width)))]
        for kind in self._kinds:
            place = np.searchsorted(kind.words, words)
            place[place == len(kind.words)] = 0
            rows = np.flatnonzero(kind.words[place] == words)
            if not rows.size:
                continue
            own, place = frames.take(rows), place[rows]
            is_short = own["length"] < kind.lengths[place]
            is_short |= own["length"] > kind.most[place]
            if is_short.any():
                short += _short(kind, own[is_short], place[is_short])
                own, rows, place = own[~is_short], rows[~is_short], place[~is_short]
            columns = kind.decoder(own["data"])
            t_ns = own["t_ns"].astype(np.int64)
            for slot, (signals, page) in enumerate(zip(kind.slots, kind.pages, strict=True)):
                here = slice(None) if page is None else ~np.isnan(columns[page])
                at = place[here]
                values = np.full((len(at), self._width), np.nan)
                with np.errstate(invalid="ignore", over="ignore"):  # any bits may come
                    for k in signals:
                        values[:, kind.roles[k]] = columns[k][here] * kind.factors[k]
                devices.append(kind.devices[at, slot])
                parts.append((kind.members[at, slot], t_ns[here], rows[here], values))
        device = np.concatenate(devices)
        columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
        order = np.lexsort((columns[2], device))
        member, t_ns, rows, values = (column[order] for column in columns)
        number = np.full(len(order), REFUSED)
        return device[order], Arrivals(member, t_ns, rows, values, t_ns, number, t_ns.copy()), short


def _short(kind: _Kind, own: FrameArray, place: NDArray[np.intp]) -> list[_Short]:
    rows = zip(own["t_ns"].tolist(), own["length"].tolist(), place.tolist(), strict=True)
    return [(one, t_ns, size) for t_ns, size, at in rows for one in set(kind.devices[at].tolist())]


def _kinds_of(layouts: Sequence[Layout]) -> list[_Kind]:
    """Return the kinds of messages that the devices use, those of equal layout together."""
    slots: dict[int, list[_Slot]] = {}
    for device, layout in enumerate(layouts):
        for member, part in enumerate(layout.parts):
            slots.setdefault(part.message.word, []).append((device, member, part))
    alike: dict[tuple[object, ...], list[int]] = {}
    for word, own in sorted(slots.items()):
        used = tuple((_used(part), part.page) for _, _, part in own)
        alike.setdefault((own[0][2].message.signals, used), []).append(word)
    return [_kind_of(words, slots) for words in alike.values()]


def _used(part: Part) -> tuple[object, ...]:
    return tuple((use.role, use.signal, use.factor) for use in part.uses)


def _kind_of(words: list[int], slots: Mapping[int, list[_Slot]]) -> _Kind:
    first = [part for _, _, part in slots[words[0]]]
    messages = {word: slots[word][0][2].message for word in words}
    used = [use for part in first for use in part.uses]
    bounds = np.cumsum([0, *(len(part.uses) for part in first)]).tolist()
    pages = [part.page for part in first if part.page is not None]
    places = iter(range(len(used), len(used) + len(pages)))
    return _Kind(
        decoder=Decoder(messages[words[0]], [*(use.signal for use in used), *pages]),
        roles=[use.role for use in used],
        factors=[1.0 if use.role == TIME else use.factor for use in used],
        slots=[range(start, stop) for start, stop in pairwise(bounds)],
        pages=[None if part.page is None else next(places) for part in first],
        words=np.array(words, np.uint32),
        lengths=np.array([messages[word].length for word in words]),
        most=np.array(
            [messages[w].length if messages[w].is_exact else MAX_DATA_BYTES for w in words]
        ),
        devices=np.array([[device for device, _, _ in slots[word]] for word in words]),
        members=np.array([[member for _, member, _ in slots[word]] for word in words]),
    )
