"""Open ports by name, as a daemon is given them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from fsw.drivers.wire import BytePort, FramePort

CAN = "can/"  # before the name of a bus's link
SECOND = ".redundant"  # behind a bus's name: the other one of the pair


@dataclass(frozen=True, slots=True, kw_only=True)
class Ports:
    """Open ports by name, and how to open a lost one again.

    A port that is None counts as lost.
    """

    can: Mapping[str, FramePort | None]
    imu: BytePort | None
    star_tracker: BytePort | None = None
    can_openers: Mapping[str, Callable[[], FramePort]] = field(default_factory=dict)
    line_openers: Mapping[str, Callable[[], BytePort]] = field(default_factory=dict)
