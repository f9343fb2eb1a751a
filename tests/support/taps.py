"""Faults of the links that only tests insert, beside those of `hil.faults.taps`."""

import struct
from collections.abc import Sequence
from itertools import groupby

import numpy as np

from hil.devices import sagitta
from hil.devices.can_segment import TimedFrame
from hil.devices.uart import TimedBytes
from hil.faults.taps import ByteAction, Edit, flip_bit


class Regrouped:
    """Byte tap that joins the chunks of one period and delivers them at its end."""

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._held: list[TimedBytes] = []

    def __call__(self, items: Sequence[TimedBytes]) -> list[TimedBytes]:
        """Return the chunks of periods that are over; keep the others."""
        period = self._period_ns
        self._held += [(-(-t_ns // period) * period, data) for t_ns, data in items]
        newest = self._held[-1][0] if self._held else 0
        done = [item for item in self._held if item[0] < newest]
        self._held = [item for item in self._held if item[0] >= newest]
        return [
            (t_ns, b"".join(data for _, data in group))
            for t_ns, group in groupby(done, key=lambda item: item[0])
        ]


class FlipEveryBit:
    """Byte action that inverts bit 0 of the first struck item, bit 1 of the next, and so on."""

    def __init__(self) -> None:
        self.bit = 0

    def __call__(self, item: TimedBytes, _rng: np.random.Generator) -> list[TimedBytes]:
        """Invert the next bit; after the last bit begin again with the first."""
        flipped = flip_bit(item[1], self.bit % (8 * len(item[1])))
        self.bit += 1
        return [(item[0], flipped)]


def forge(edit: Edit) -> ByteAction:
    """Return the action that adds an edited transmission after the true one."""
    return lambda item, rng: [item, (item[0], edit(item[1], rng))]


def sagitta_fields(
    *,
    address: int = sagitta.ADDRESS,
    q_wxyz: Sequence[float] | None = None,
    time_step_us: int = 0,
    cut: int = 0,
) -> Edit:
    """Return the edit of a Sagitta solution that sets fields and drops `cut` payload bytes."""

    def edit(data: bytes, _rng: np.random.Generator) -> bytes:
        payload = sagitta.unframe(data[1:-1])
        if payload is None:
            raise ValueError(f"no frame of a star tracker: {data.hex()}")
        body = bytearray(payload)
        body[0] = address
        (unix_us,) = struct.unpack_from("<Q", body, 8)
        struct.pack_into("<Q", body, 8, unix_us + time_step_us)
        if q_wxyz is not None:
            struct.pack_into("<4f", body, 16, *q_wxyz)
        return sagitta.frame(bytes(body[: len(body) - cut]))

    return edit


def flip_payload(frame: TimedFrame, rng: np.random.Generator) -> list[TimedFrame]:
    """Invert one bit of the data of a frame."""
    t_ns, can_id, data, is_fd = frame
    return [(t_ns, can_id, flip_bit(data, int(rng.integers(8 * len(data)))), is_fd)]
