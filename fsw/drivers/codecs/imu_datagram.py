"""The datagram that the codec of every inertial unit hands to its source."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fsw.drivers.codecs.framing import Frame, Framer
from fsw.drivers.wire import ByteChunk, Reject
from fsw.messages import FloatArray

Vector3 = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class ImuDatagram:
    """One datagram in SI units and sensor axes; None: a cluster is absent or unusable."""

    counter: int  # device time [ticks], modulo the codec's modulus
    latency_s: float  # from validity to the first byte on the wire, group delay not included
    w_NS_S_rad_s: Vector3 | None
    f_NS_S_m_s2: Vector3 | None
    gyro_status: int
    acc_status: int


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
    """A stream codec of an inertial unit whose datagrams carry the unit's own time."""

    framer: Framer
    tick_s: float  # one tick of the device's counter [s]
    modulus: int  # the counter wraps here

    def decode(self, frame: Frame) -> ImuDatagram | Reject | None:
        """Decode a whole frame; return None for a valid frame without a measurement."""
        ...

    def lacks(self) -> str:
        """Return words on the data that no frame has had so far; empty: none is missing."""
        ...

    def run(self, chunks: Sequence[ByteChunk]) -> ImuRun | None:
        """Decode leading chunks of usable datagrams without feeding them; None if none."""
        ...
