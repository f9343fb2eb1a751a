"""Configuration of CAN buses and live feeds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import (
    Field,
    model_validator,
)

from fsw.config.base import (
    DelaySigma,
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
    """channel of the second bus of a redundant pair ([icd.md](icd.md), section 1); needs
    `heartbeat_s` and `sync: producer`"""
    port: int | None = Field(default=None, ge=1, le=65535)
    """its UDP port, for `udp_multicast` and `udp_frames` only"""
    lost_after_s: Duration = 0.3
    """without a frame of any node for so long the active bus is lost and the other is taken; at
    least 5 SYNC periods"""
    nodes_toggle_s: Duration
    """Ttoggle x consumer heartbeat time of the nodes; at least 1.5 `heartbeat_s`"""


class BusConfig(Section):
    """One CAN bus. `name` is also the recording's topic: /can/<name>."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_]+$")]
    """free name of letters, digits and `_`; joints refer to it, recordings call the channel
    `/can/NAME`"""
    interface: str | None = None
    """required by `fsw run` only: python-can interface: `socketcan`, `udp_multicast`, `slcan`,
    `virtual` ..., or `udp_frames` (struct can_frame over UDP multicast, on a bench in place of
    SocketCAN); `samples`: no bus, its joints' values come from [fsw import](import.md), or live by
    `feed` ([howto/feed.md](howto/feed.md)), at any rate"""
    feed: FeedConfig | None = None  # of interface samples: who sends them live; None: recordings
    channel: str | None = None
    """required by `fsw run` only: python-can channel: `can0`, a multicast group `239.0.0.1`, a
    serial path ...; of a feed: a numeric address, with `port`, or the path of a Unix socket"""
    description: Path | None = None
    """DBC, KCD, SYM or ARXML file of the foreign devices on this bus ([how](howto/connect.md));
    joints with `driver: described` name its messages"""
    messages: Annotated[tuple[LayoutMessageConfig, ...], Field(max_length=256)] = ()
    listen_only: bool = False
    """another master runs the bus: the daemon never sends a frame, neither SYNC nor NMT nor
    heartbeat"""
    fd: bool = False
    """open the bus for CAN FD; needed by joints of format `fd`"""
    bitrate: int | None = Field(default=None, gt=0)
    """nominal bit/s; null where the system sets it (socketcan). The load check then assumes 1
    Mbit/s"""
    data_bitrate: int | None = Field(default=None, gt=0)
    """data phase of CAN FD, bit/s; null: the load check assumes 5 Mbit/s"""
    port: int | None = Field(default=None, ge=1, le=65535)
    """UDP port, for `udp_multicast`, `udp_frames` and a feed only"""
    sync: Literal["producer", "consumer", "none"] = "producer"
    """`producer`: the daemon sends SYNC with its counter; `consumer`: another node does; `none`:
    nobody does, only for described joints with a time of their own"""
    rate_hz: Rate
    """SYNC rate; must divide `scheduler.tick_rate_hz`. Of a feed: rate of its datagrams, any"""
    sync_counter_max: Annotated[int, Field(ge=0, le=240)] = 240
    """the counter runs 1 to this (object 0x1019); 0: SYNC has no data byte"""
    latch_offset_s: Finite = 0.0
    """time of validity of a joint sample minus the stamp of its SYNC, or of the request that it
    answers; shorter than a SYNC period"""
    delay_sigma_s: DelaySigma = 0.0
    """1 sigma of a constant delay of all samples of its joints against the inertial unit, a state;
    at most a tenth of `estimator.window_s`. 0: exact"""
    heartbeat_s: Duration | None = None
    """period of the computer's heartbeat (node 0x01) on this bus; null: none is sent"""
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
