"""Section of a bus whose samples come as datagrams from another program: a live feed."""

from ipaddress import ip_address
from pathlib import Path
from typing import Literal

from pydantic import Field

from fsw.config.base import Positive, Section

Clock = Literal["monotonic", "unix", "tai", "device"]
SHARED_CLOCKS = (
    "unix",
    "tai",
)  # continue when the sender restarts, so that no datagram is replayed

SAMPLES = "samples"  # values that another program decoded: of a feed, or in recordings only


class FeedConfig(Section):
    """The sender of a live feed, the clock of its times, and the key that authenticates it."""

    source: int = Field(ge=0, le=0xFFFFFFFF)
    """number of the sender of a live feed ([howto/feed.md](howto/feed.md)); datagrams of other
    senders are refused. Needs `interface: samples`"""
    clock: Clock = "monotonic"
    """the clock of the sender's times; all but `monotonic`, this machine's own, are fitted under
    the arrivals"""
    clock_tolerance_ppm: Positive = 200.0
    """bound of the rate error of such a clock"""
    key_file: Path | None = None
    """file of 32 random bytes, mode 0600, that authenticates the sender; required where `channel`
    is not a loopback address; needs clock `unix` or `tai`"""


def check_address(feed: FeedConfig, channel: str | None, port: int | None) -> None:
    """Raise ValueError for an address, clock and key that do not go together.

    `channel` is the path of a Unix socket, or with `port` the numeric address of a UDP socket.
    """
    if feed.key_file is not None and feed.clock not in SHARED_CLOCKS:
        raise ValueError(
            f"feed.clock: {feed.clock!r} with key_file; must be {' or '.join(SHARED_CLOCKS)}, "
            "whose times never begin again and so show replayed datagrams"
        )
    if channel is None or port is None:
        return
    try:
        address = ip_address(channel)
    except ValueError as error:
        raise ValueError(f"channel: {channel!r} must be a numeric address") from error
    if not address.is_loopback and feed.key_file is None:
        raise ValueError(
            f"feed.key_file: missing; channel {channel} is not the loopback address, and without a "
            "key anybody may send"
        )
