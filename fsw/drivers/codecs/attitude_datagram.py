"""What the codec of a star tracker is, and the solution that it hands to its source."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

from fsw.drivers.codecs.framing import Framer
from fsw.drivers.wire import Reject


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeDatagram:
    """Attitude and time as the unit gives them; its quaternion turns as `rotation` says."""

    unix_us: int  # of the unit's clock; 0: its time is not set
    q_wxyz: tuple[float, float, float, float]


class StarTrackerCodec(Protocol):
    """A stream codec of a star tracker; options are declared as by `ImuCodec`."""

    title: ClassVar[str]  # the device, in a few words
    devices: ClassVar[Mapping[str, Mapping[str, Any]]] = {}  # figures of units for `fsw init`
    framer: Framer
    frame_bytes: tuple[int, int]  # a solution without escapes, the longest solution

    def decode(self, frame: bytes) -> AttitudeDatagram | Reject | object:
        """Decode a whole frame; an object of another type is telemetry without an attitude."""
        ...

    def start(self) -> bytes:
        """Return what asks the unit for its solutions; it is sent when the port is opened."""
        return b""
