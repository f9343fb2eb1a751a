"""Faults of measured values, written into the sensor's frames: stuck, spike, drift, scale, jump.

Actions for `hil.faults.taps.Struck`; the check values of changed frames are correct.
"""

import math
import struct
from collections.abc import Callable, Sequence

import numpy as np

from hil.devices import sagitta, stim300, tpdo1
from hil.devices.can_segment import TimedFrame
from hil.devices.canopen import COUNTS_PER_RAD
from hil.devices.tpdo1 import clamp
from hil.devices.uart import TimedBytes
from hil.faults.taps import ByteAction, FrameAction

CLUSTER_AT = {"gyro": 1, "acc": 11}
LSB = {"gyro": stim300.RATE_LSB_RAD_S, "acc": stim300.ACC_LSB_G[10] * stim300.G_M_S2}
STATUS_OFFSET = 9  # from a cluster's first byte
VALID_AT = 77  # offset in a solution's payload
Change = Callable[[float, int], float]  # maps value and time [ns] to the new value


def scaled(ratio: float) -> Change:
    """Return the change that multiplies a value by `ratio`."""
    return lambda value, _t_ns: value * ratio


def shifted(offset: float) -> Change:
    """Return the change that adds `offset`, in the value's unit."""
    return lambda value, _t_ns: value + offset


def drifting(rate_per_s: float, since_ns: int) -> Change:
    """Return the change that adds a drift, which was zero at `since_ns`."""
    return lambda value, t_ns: value + rate_per_s * (t_ns - since_ns) * 1e-9


class Stuck:
    """Change that repeats the first value."""

    def __init__(self) -> None:
        self._value: float | None = None

    def __call__(self, value: float, _t_ns: int) -> float:
        """Return the first value."""
        if self._value is None:
            self._value = value
        return self._value


def torque(change: Change) -> FrameAction:
    """Return the action that changes the torque [N m] of a TPDO1."""
    return _measured("torque", lambda form: form.counts_per_nm, change)


def position(change: Change) -> FrameAction:
    """Return the action that changes the position [rad] of a TPDO1."""
    return _measured("position", lambda _form: COUNTS_PER_RAD, change)


def _measured(
    name: tpdo1.Field, counts: Callable[[tpdo1.Layout], float], change: Change
) -> FrameAction:
    def changed(frame: TimedFrame, _rng: np.random.Generator) -> list[TimedFrame]:
        t_ns, can_id, data, is_fd = frame
        form = tpdo1.layout(data)
        if form is None:
            return [frame]
        value = change(form.read(data, name) / counts(form), t_ns)
        return [(t_ns, can_id, form.written(data, {name: value * counts(form)}), is_fd)]

    return changed


Edit = Callable[[bytearray, int, np.random.Generator], None]  # edits a body; time [ns]


def _resealed(body: bytes | bytearray) -> bytes:
    padded = bytes(body) + bytes(-len(body) % 4)
    return bytes(body) + stim300.crc32_mpeg2(padded).to_bytes(4, "big")


def _datagram(edit: Edit) -> ByteAction:
    """Return the action that edits an intact datagram and corrects the check value.

    A datagram that another fault has damaged does not change.
    """

    def changed(item: TimedBytes, rng: np.random.Generator) -> list[TimedBytes]:
        t_ns, data = item
        body = bytearray(data[:-4])
        if _resealed(body) != data:
            return [item]
        edit(body, t_ns, rng)
        return [(t_ns, _resealed(body))]

    return changed


def inertial(cluster: str, changes: Sequence[Change]) -> ByteAction:
    """Return the action that changes the three axes [rad/s or m/s^2] of a cluster."""

    def edit(body: bytearray, t_ns: int, _rng: np.random.Generator) -> None:
        lsb = LSB[cluster]
        for axis, change in enumerate(changes):
            at = CLUSTER_AT[cluster] + 3 * axis
            raw = int.from_bytes(body[at : at + 3], "big", signed=True)
            raw = clamp(change(raw * lsb, t_ns) / lsb, 24)
            body[at : at + 3] = raw.to_bytes(3, "big", signed=True)

    return _datagram(edit)


def _flip_upper(body: bytearray, _t_ns: int, rng: np.random.Generator) -> None:
    at = CLUSTER_AT["acc"] + 3 * int(rng.integers(3))
    bit = int(rng.integers(16, 22))
    raw = int.from_bytes(body[at : at + 3], "big", signed=True) ^ (1 << bit)
    body[at : at + 3] = raw.to_bytes(3, "big", signed=True)


# inverts an upper bit of a specific force and corrects the CRC
flip_unseen = _datagram(_flip_upper)


def flagged(*, gyro: int = 0, acc: int = 0) -> ByteAction:
    """Return the action that sets status bits of the clusters gyro and acc."""

    def edit(body: bytearray, _t_ns: int, _rng: np.random.Generator) -> None:
        body[CLUSTER_AT["gyro"] + STATUS_OFFSET] |= gyro
        body[CLUSTER_AT["acc"] + STATUS_OFFSET] |= acc

    return _datagram(edit)


def counted_on(step: int) -> ByteAction:
    """Return the action that adds `step` to a datagram's counter."""

    def edit(body: bytearray, _t_ns: int, _rng: np.random.Generator) -> None:
        body[-3] = (body[-3] + step) & 0xFF

    return _datagram(edit)


def solution(*, turn_rad: float = 0.0, blind: bool = False, time_step_us: int = 0) -> ByteAction:
    """Return the action that turns a solution about the tracker's y, clears valid, shifts time.

    Other transmissions of the unit do not change.
    """

    def changed(item: TimedBytes, _rng: np.random.Generator) -> list[TimedBytes]:
        payload = sagitta.unframe(item[1][1:-1])
        if payload is None or len(payload) <= VALID_AT:
            return [item]
        body = bytearray(payload)
        (unix_us,) = struct.unpack_from("<Q", body, 8)
        struct.pack_into("<Q", body, 8, unix_us + time_step_us)
        w, x, y, z = struct.unpack_from("<4f", body, 16)
        c, s = math.cos(0.5 * turn_rad), math.sin(0.5 * turn_rad)
        turned = (c * w - s * y, c * x - s * z, c * y + s * w, c * z + s * x)
        if turn_rad:
            struct.pack_into("<4f", body, 16, *turned)
        body[VALID_AT] = 0 if blind else body[VALID_AT]
        return [(item[0], sagitta.frame(bytes(body)))]

    return changed
