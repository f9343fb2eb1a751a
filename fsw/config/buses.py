"""Configuration of CAN buses and live feeds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import (
    Field,
    model_validator,
)

from fsw.config.base import (
    Duration,
    Finite,
    Rate,
    Section,
)
from fsw.config.feed import SAMPLES, FeedConfig, check_address
from fsw.config.signals import LayoutMessageConfig

LINES = ("imu", "star_tracker")


class RedundantBusConfig(Section):
    """The second bus of a redundant pair; nodes use one bus at a time (ECSS-E-ST-50-15C)."""

    channel: str
    port: int | None = Field(default=None, ge=1, le=65535)  # for udp_multicast and udp_frames
    lost_after_s: Duration = 0.3  # the active bus is lost if no node sends for this time
    nodes_toggle_s: Duration  # Ttoggle times the nodes' consumer heartbeat time


class BusConfig(Section):
    """One CAN bus. `name` is also the recording's topic: /can/<name>."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_]+$")]
    interface: str | None = None  # samples, or one of python-can: socketcan, udp_multicast ...
    feed: FeedConfig | None = None  # of interface samples: who sends them live; None: recordings
    channel: str | None = None  # a replay needs neither interface nor channel
    description: Path | None = None  # DBC, KCD, SYM or ARXML of foreign devices on the bus
    messages: Annotated[tuple[LayoutMessageConfig, ...], Field(max_length=256)] = ()
    listen_only: bool = False  # another master runs the bus: the daemon never sends a frame
    fd: bool = False
    bitrate: int | None = Field(default=None, gt=0)
    data_bitrate: int | None = Field(default=None, gt=0)
    port: int | None = Field(default=None, ge=1, le=65535)  # for a feed and CAN over UDP
    sync: Literal["producer", "consumer", "none"] = "producer"  # none: nobody sends SYNC
    rate_hz: Rate  # of SYNC; of the joints' samples
    sync_counter_max: Annotated[int, Field(ge=0, le=240)] = 240  # 0: SYNC has no data
    latch_offset_s: Finite = 0.0  # time of validity of joint samples minus SYNC stamp
    heartbeat_s: Duration | None = None  # period of the computer's heartbeat; None: none is sent
    redundant: RedundantBusConfig | None = None

    @model_validator(mode="after")
    def _feed_works(self) -> Self:
        """Refuse a feed that cannot be received, and keys of CAN beside it."""
        if self.feed is None:
            return self
        if self.interface != SAMPLES:
            raise ValueError(f"interface: {self.interface!r} with feed; must be {SAMPLES!r}")
        if self.name in LINES:
            raise ValueError(f"name: {self.name!r} is a serial line; a feed needs another name")
        for key in ("redundant", "heartbeat_s"):
            if getattr(self, key) is not None:
                raise ValueError(f"{key}: a feed has none; must be left out")
        check_address(self.feed, self.channel, self.port)
        return self

    @model_validator(mode="after")
    def _only_listens(self) -> Self:
        """Refuse keys that would make a daemon send that may only listen."""
        if self.sync_counter_max == 1:
            raise ValueError("sync_counter_max: 1; must be 0 or 2 to 240")
        if self.listen_only and self.sync == "producer":
            raise ValueError("sync: 'producer' with listen_only; must be consumer or none")
        if self.listen_only and self.heartbeat_s is not None:
            raise ValueError(f"heartbeat_s: {self.heartbeat_s:g} with listen_only; leave it out")
        return self

    def second(self) -> BusConfig | None:
        """Return the configuration of the redundant bus; None without one."""
        if self.redundant is None:
            return None
        changes = {"channel": self.redundant.channel, "port": self.redundant.port}
        return self.model_copy(update=changes)
