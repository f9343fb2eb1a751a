"""The datagram that the codec of every inertial unit hands to its source."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from fsw.drivers.codecs.framing import Frame, Framer
from fsw.drivers.wire import Reject

Vector3 = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class ImuDatagram:
    """One datagram in SI units and sensor axes; None: cluster absent or flagged unusable."""

    counter: int  # device time [ticks], modulo the codec's modulus
    latency_s: float  # from validity to the first byte on the wire, group delay not included
    w_NS_S_rad_s: Vector3 | None
    f_NS_S_m_s2: Vector3 | None
    gyro_status: int
    acc_status: int


class ImuCodec(Protocol):
    """A stream codec of an inertial unit whose datagrams carry the unit's own time."""

    framer: Framer
    tick_s: float  # one tick of the device's counter [s]
    modulus: int  # the counter wraps here

    def decode(self, frame: Frame) -> ImuDatagram | Reject | None:
        """Decode a whole frame; None: a valid frame that is no measurement."""
        ...
