"""Faults of the links: seeded, composable taps for virtual links, and edits of recorded traffic.

An action maps one item on its way to the host (one transmission of a serial device, or one CAN
frame) to the items that replace it. `Struck` applies an action to randomly chosen items; `chain`
connects taps in series. Every random draw belongs to one item, so the result does not depend on
how the items are batched. Serial actions need one transmission per chunk (the devices' chunking
`datagram`).
"""

from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

import numpy as np

from hil.devices import stim300, tpdo1
from hil.devices.can_segment import TimedFrame
from hil.devices.canopen import SYNC_ID
from hil.devices.uart import TimedBytes

Item = TypeVar("Item", TimedFrame, TimedBytes)
Tap = Callable[[Sequence[Item]], Sequence[Item]]
Action = Callable[[Item, np.random.Generator], Sequence[Item]]
Edit = Callable[[bytes, np.random.Generator], bytes]
FrameAction = Callable[[TimedFrame, np.random.Generator], Sequence[TimedFrame]]
ByteAction = Callable[[TimedBytes, np.random.Generator], Sequence[TimedBytes]]

FAULT_STREAM = 0xFA  # spawn key of a fault's draws, different from all devices' keys
FOREVER_NS = 1 << 62
TPDO1_ID, NODE_MASK = 0x180, 0x7F
SYNC_BYTES = b"\xa5\xc0\xdb\x75\x90"  # first bytes of frames, so that junk resembles frames


class Struck(Generic[Item]):
    """Tap that applies an action to a random share of the candidate items.

    Parameters
    ----------
    rate : probability that a candidate is struck
    seed : fixes which items are struck, and the action's random draws
    only : function that returns whether an item is a candidate; None: all items are
    window_ns : [from, to) of the candidates' times
    rest : number of candidates after a struck item that are not struck
    """

    def __init__(
        self,
        action: Action[Item],
        rate: float,
        seed: int,
        *,
        only: Callable[[Item], bool] | None = None,
        window_ns: tuple[int, int] = (0, FOREVER_NS),
        rest: int = 0,
    ) -> None:
        self.count = 0
        self.first_ns: int | None = None  # time of the first struck item
        self.last_ns: int | None = None
        self._rest, self._resting = rest, 0
        self._action: Action[Item] = action
        self._only: Callable[[Item], bool] | None = only
        self._rate, self._window = rate, window_ns
        sequence = np.random.SeedSequence(seed, spawn_key=(FAULT_STREAM,))
        self._chance, self._rng = (np.random.default_rng(s) for s in sequence.spawn(2))

    def __call__(self, items: Sequence[Item]) -> list[Item]:
        """Return the items after the tap."""
        out: list[Item] = []
        for item in items:
            first, last = self._window
            asked = first <= item[0] < last and (self._only is None or self._only(item))
            struck = asked and self._chance.random() < self._rate and not self._resting
            self._resting = max(0, self._resting - asked)
            if struck:
                self.count += 1
                self.first_ns = item[0] if self.first_ns is None else self.first_ns
                self.last_ns = item[0]
                self._resting = self._rest
                out += self._action(item, self._rng)
            else:
                out.append(item)
        return out


def chain(*taps: Tap[Item]) -> Tap[Item]:
    """Return the tap that passes items through the taps in order."""

    def through(items: Sequence[Item]) -> Sequence[Item]:
        for tap in taps:
            items = tap(items)
        return items

    return through


def drop(_item: Item, _rng: np.random.Generator) -> list[Item]:
    """Drop the item; with rate 1 this is a silent device."""
    return []


def duplicate(item: Item, _rng: np.random.Generator) -> list[Item]:
    """Deliver the item twice."""
    return [item, item]


def delay(delay_ns: int) -> Action[Item]:
    """Return the action that delivers an item `delay_ns` later."""

    def late(item: Item, _rng: np.random.Generator) -> list[Item]:
        return [(item[0] + delay_ns, *item[1:])]

    return late


def keep(item: Item, _rng: np.random.Generator) -> list[Item]:
    """Leave the item as it is."""
    return [item]


class Delayed(Generic[Item]):
    """Action that delays items by a delay plus random jitter and keeps their order."""

    def __init__(self, delay_ns: int, jitter_ns: int = 0) -> None:
        self._delay_ns, self._jitter_ns = delay_ns, jitter_ns
        self._newest_ns = 0

    def __call__(self, item: Item, rng: np.random.Generator) -> list[Item]:
        """Deliver the item later."""
        extra_ns = round(self._jitter_ns * float(rng.random()))
        self._newest_ns = max(self._newest_ns, item[0] + self._delay_ns + extra_ns)
        return [(self._newest_ns, *item[1:])]

    def follow(self, item: Item, _rng: np.random.Generator) -> list[Item]:
        """Deliver an undelayed item, but not before the delayed items."""
        self._newest_ns = max(self._newest_ns, item[0])
        return [(self._newest_ns, *item[1:])]


class Overtaken:
    """Frame tap that delivers a struck frame just after the node's next frame."""

    def __init__(self, struck: Struck[TimedFrame]) -> None:
        self._struck = struck
        self._held: list[TimedFrame] = []

    def __call__(self, items: Sequence[TimedFrame]) -> list[TimedFrame]:
        """Return the frames in their new order."""
        out: list[TimedFrame] = []
        for item in items:
            before = self._struck.count
            (kept,) = self._struck([item])
            if self._struck.count > before:
                self._held.append(kept)
                continue
            out.append(kept)
            ready = [held for held in self._held if held[1] == kept[1]]
            self._held = [held for held in self._held if held[1] != kept[1]]
            out += [(kept[0] + 1000, *held[1:]) for held in ready]
        return out


def noise(max_bytes: int) -> ByteAction:
    """Return the action that prepends 1 to max_bytes random bytes, a fifth of them sync bytes."""

    def junk(item: TimedBytes, rng: np.random.Generator) -> list[TimedBytes]:
        count = int(rng.integers(1, max_bytes + 1))
        octets = bytearray(rng.bytes(count))
        for at in np.flatnonzero(rng.random(count) < 0.2):
            octets[at] = SYNC_BYTES[int(rng.integers(len(SYNC_BYTES)))]
        return [(item[0], bytes(octets) + item[1])]

    return junk


def truncate(item: TimedBytes, rng: np.random.Generator) -> list[TimedBytes]:
    """Drop the transmission's end, at least one byte but not all."""
    return [(item[0], item[1][: int(rng.integers(1, len(item[1])))])]


def behead(item: TimedBytes, rng: np.random.Generator) -> list[TimedBytes]:
    """Drop the transmission's beginning, at least one byte but not all."""
    return [(item[0], item[1][int(rng.integers(1, len(item[1]))) :])]


def flip_bit(data: bytes, bit: int) -> bytes:
    """Return the bytes with one bit inverted; bit 0 is the lowest of the first byte."""
    out = bytearray(data)
    out[bit // 8] ^= 1 << bit % 8
    return bytes(out)


def flip(item: TimedBytes, rng: np.random.Generator) -> list[TimedBytes]:
    """Invert one bit of a transmission."""
    return [(item[0], flip_bit(item[1], int(rng.integers(8 * len(item[1])))))]


def rewrite(edit: Edit) -> ByteAction:
    """Return the action that edits a transmission; `edit` must set the check value."""
    return lambda item, rng: [(item[0], edit(item[1], rng))]


def stim_fields(
    *,
    counter_step: int = 0,
    latency_us: int | None = None,
    gyro: Sequence[int] | None = None,
    acc: Sequence[int] | None = None,
    status: int = 0,
    acc_status: int = 0,
) -> Edit:
    """Return the edit of a STIM300 datagram without CR LF that sets raw fields.

    Parameters
    ----------
    counter_step : number that is added to the counter
    gyro, acc : three raw 24-bit readings
    status, acc_status : bits that are set in the status of gyro and accelerometer
    """

    def edit(data: bytes, _rng: np.random.Generator) -> bytes:
        body = bytearray(data[:-4])
        for at, raw in ((1, gyro), (11, acc)):
            if raw is not None:
                body[at : at + 9] = b"".join(v.to_bytes(3, "big", signed=True) for v in raw)
        body[10] |= status
        body[20] |= acc_status
        body[-3] = (body[-3] + counter_step) & 0xFF
        if latency_us is not None:
            body[-2:] = latency_us.to_bytes(2, "big")
        padded = bytes(body) + bytes(-len(body) % 4)
        return bytes(body) + stim300.crc32_mpeg2(padded).to_bytes(4, "big")

    return edit


def is_tpdo1(frame: TimedFrame) -> bool:
    """Return whether a frame is a TPDO1: a joint's position and torque."""
    return TPDO1_ID < frame[1] <= TPDO1_ID + NODE_MASK


def is_node(node_id: int) -> Callable[[TimedFrame], bool]:
    """Return a function that returns whether a frame, of any service, is from the node."""
    return lambda frame: frame[1] > SYNC_ID and frame[1] & NODE_MASK == node_id


def as_node(node_id: int) -> FrameAction:
    """Return the action that adds a copy of the frame from another node."""
    return lambda frame, _rng: [
        frame,
        (frame[0], (frame[1] & ~NODE_MASK) | node_id, *frame[2:]),
    ]


def change_frame(
    *,
    counter_step: int = 0,
    counter_max: int = 240,
    length: int | None = None,
    position: int | None = None,
    torque: int | None = None,
    status: int | None = None,
) -> FrameAction:
    """Return the action that sets raw fields of a TPDO1, or its length."""
    given: dict[tpdo1.Field, int | None]
    given = {"position": position, "torque": torque, "status": status}
    fields = {name: value for name, value in given.items() if value is not None}

    def changed(frame: TimedFrame, _rng: np.random.Generator) -> list[TimedFrame]:
        t_ns, can_id, data, is_fd = frame
        form = tpdo1.layout(data)
        if form is None:
            return [frame]
        counter = (form.read(data, "counter") - 1 + counter_step) % counter_max + 1
        data = form.written(data, {**fields, "counter": counter})
        return [(t_ns, can_id, data[:length], is_fd)]

    return changed
