"""The open ports of a daemon, by name."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from fsw.drivers.wire import BytePort, FramePort

CAN = "can/"  # prefix of the name of a CAN link
SECOND = ".redundant"  # suffix of the name of the redundant bus of a pair


@dataclass(frozen=True, slots=True, kw_only=True)
class Ports:
    """Open ports by name, and the functions that open a lost port again.

    A port that is None counts as lost.
    """

    can: Mapping[str, FramePort | None]
    imu: BytePort | None
    star_tracker: BytePort | None = None
    feeds: Mapping[str, BytePort | None] = field(default_factory=dict)
    can_openers: Mapping[str, Callable[[], FramePort]] = field(default_factory=dict)
    line_openers: Mapping[str, Callable[[], BytePort]] = field(default_factory=dict)
