"""What the codec of an inertial unit is, and the datagram that it hands to its source."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from fsw.drivers.codecs.framing import Frame, Framer
from fsw.drivers.wire import ByteChunk, Reject
from fsw.messages import FloatArray

Vector3 = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class ImuDatagram:
    """One datagram in SI units and sensor axes; None: a cluster is absent or unusable.

    An interval is the time over which the unit averaged the values, which ends when the device
    time was read. 0: the values are of that instant. None: they are increments (rad, m/s) of one
    step of the counter; the source divides them by this step.
    """

    counter: int  # device time [ticks], modulo the codec's modulus
    latency_s: float  # from validity to the first byte on the wire, group delay not included
    w_NS_S_rad_s: Vector3 | None
    f_NS_S_m_s2: Vector3 | None
    gyro_status: int = 0  # bits of the device; other than 0: not as usual
    acc_status: int = 0
    gyro_interval_s: float | None = 0.0
    acc_interval_s: float | None = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class ImuRun:
    """Consecutive datagrams of one kind, in chunks that hold nothing else."""

    chunks: Sequence[ByteChunk]
    length: int  # length of a datagram [bytes]
    counter: NDArray[np.int64]  # (k,) device time [ticks], modulo the codec's modulus
    latency_s: FloatArray  # (k,) as in `ImuDatagram`
    w_NS_S_rad_s: FloatArray  # (k, 3)
    f_NS_S_m_s2: FloatArray  # (k, 3)


class ImuCodec(Protocol):
    """A stream codec of an inertial unit whose datagrams carry the unit's own time.

    A codec that derives from this class needs to define only what differs. The parameters of
    `__init__` are its options: those named as a key of the section `imu` get this key's value,
    others are keys of `imu.options`.
    """

    title: ClassVar[str]  # the device, in a few words
    devices: ClassVar[Mapping[str, Mapping[str, Any]]] = {}  # figures of units for `fsw init`
    rates_hz: Sequence[float] = ()  # rates that the device offers; empty: any
    max_rate_rad_s: float = math.inf  # the wire carries no faster rate
    start_up_bits: int = 0  # of a status: the device is starting
    overload_bits: int = 0  # of a status: the value was out of the device's range
    framer: Framer
    frame_bytes: tuple[int, int]  # shortest datagram with both clusters, longest datagram
    tick_s: float  # one tick of the device's counter [s]
    modulus: int  # the counter wraps here

    def decode(self, frame: Frame) -> ImuDatagram | Reject | None:
        """Decode a whole frame; return None for a valid frame without a measurement."""
        ...

    def lacks(self) -> str:
        """Return in words which data no frame has had so far; empty: none is missing."""
        return ""

    def run(self, chunks: Sequence[ByteChunk]) -> ImuRun | None:  # noqa: ARG002
        """Decode leading chunks of usable datagrams without feeding them; None: there are none."""
        return None


def scaled(values: Sequence[float], scale: float) -> Vector3:
    """Return three values times a scale."""
    x, y, z = values
    return (x * scale, y * scale, z * scale)
