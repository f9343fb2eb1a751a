"""Sections of the link to the ground."""

from ipaddress import ip_address
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from fsw.config.base import Interval, Positive, Rate, Section
from fsw.config.sdls import SdlsConfig

JOINT_SLOTS = 8  # joints in a packet of fixed size; `fsw check` reports joints left out
BUS_SLOTS = 4
# folders of the state directory that file transfer may not use
STATE_FOLDERS = (
    "boot",
    "event_actions",
    "packet_store_switches",
    "packet_stores",
    "parameters",
    "schedule",
    "sequences",
    "tables",
)


class UdpConfig(Section):
    """Address to which the daemon sends telemetry over UDP, one packet per datagram."""

    host: str = "127.0.0.1"
    """numeric address telemetry is pushed to, one packet per datagram"""
    port: int = Field(ge=1, le=65535)
    """its port"""


class PacketStoresConfig(Section):
    """Sizes of the packet stores; a full store discards its oldest packets."""

    events_bytes: int = Field(default=4 << 20, ge=1 << 20, le=1 << 30)
    """size of the packet store of events, verification and monitoring; a full one loses its oldest
    packets"""
    housekeeping_bytes: int = Field(default=64 << 20, ge=1 << 20, le=1 << 30)
    """size of the packet store of housekeeping"""
    science_bytes: int = Field(default=64 << 20, ge=1 << 20, le=1 << 30)
    """size of the packet store of science"""


class TelemetryConfig(Section):
    """Telemetry and telecommands; without this section the daemon has neither."""

    host: str = "127.0.0.1"
    """numeric address the link listens on; another than loopback needs `tc_security: sdls`"""
    port: int = Field(default=10025, ge=0, le=65535)
    """TCP port; 0: any free one, reported in the status file"""
    look_port: int | None = Field(default=None, ge=0, le=65535)
    """second TCP port, for looking only: telemetry in full, every telecommand is refused; 0: any
    free one"""
    idle_timeout_s: Positive = Field(default=60.0, ge=1.0, le=86400.0)
    """a client that reads nothing for so long is disconnected"""
    max_clients: int = Field(default=4, ge=1, le=16)
    """ground clients at a time on a port; one more place is kept for who commands"""
    queue_bytes: int = Field(default=1 << 20, ge=65536, le=1 << 24)
    """telemetry that may wait for one slow client; what does not fit is dropped and counted"""
    udp: UdpConfig | None = None
    tc_security: Literal["none", "sdls"] = "none"
    """whether telecommands must be authenticated"""
    sdls: SdlsConfig | None = None
    start_mode: Literal["identify", "standby", "safe"] = "identify"
    """mode after the start"""
    science_rate_hz: Rate = 100.0
    """how often the loop hands over the newest samples: the fastest a science packet can come"""
    housekeeping_interval_s: Interval = 1.0
    """period of the housekeeping sets 1, 2, 4, 5 and 8; sets 3, 6 and 7 come a fifth as often; 0:
    only on request"""
    science_interval_s: Interval = 0.0
    """period of the science packets; 0: only on request"""
    packet_stores: PacketStoresConfig = PacketStoresConfig()
    file_directory: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")] = "files"
    """folder in `service.state_directory` from which files go down and into which they come up"""

    @model_validator(mode="after")
    def _own_folder(self) -> Self:
        if self.file_directory in STATE_FOLDERS:
            raise ValueError(
                f"file_directory: {self.file_directory!r} is a folder of the daemon's own state; "
                f"must be none of {', '.join(STATE_FOLDERS)}"
            )
        return self

    @model_validator(mode="after")
    def _science(self) -> Self:
        shortest_s = 1.0 / self.science_rate_hz
        if 0.0 < self.science_interval_s < shortest_s * (1.0 - 1e-9):
            raise ValueError(
                f"science_interval_s: {self.science_interval_s:g} must be 0, or at least "
                f"{shortest_s:g}: samples are handed over at science_rate_hz "
                f"{self.science_rate_hz:g}"
            )
        return self

    @model_validator(mode="after")
    def _secure(self) -> Self:
        if (self.tc_security == "sdls") != (self.sdls is not None):
            raise ValueError("tc_security: 'sdls' needs the section sdls, and the other way round")
        hosts = {"host": self.host} | ({"udp.host": self.udp.host} if self.udp else {})
        for key, host in hosts.items():
            try:
                address = ip_address(host)
            except ValueError as error:
                raise ValueError(f"{key}: {host!r} must be a numeric address") from error
            if key == "host" and self.tc_security == "none" and not address.is_loopback:
                raise ValueError(
                    f"host: {host} needs tc_security: sdls; unauthenticated telecommands are "
                    "taken on the loopback address only"
                )
        return self
