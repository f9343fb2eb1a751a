"""Section of the authenticated link (SDLS) and its keys."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from fsw.config.base import Section


class SdlsKeyConfig(Section):
    """One key slot with a key of 32 bytes, in a file of mode 0600 or a systemd credential."""

    spi: int = Field(ge=1, le=65534)
    """security parameter index of the key"""
    role: Literal["command", "look", "telemetry"] = "command"
    """what the key is for: telecommands (one or two keys); authentic, but every telecommand is
    refused (up to two); seals telemetry, which is in clear without one (at most one)"""
    file: Path | None = None
    """file of 32 bytes, closed to others (0600)"""
    credential: str | None = None
    """name of a systemd credential of 32 bytes instead"""

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        if (self.file is None) == (self.credential is None):
            raise ValueError("one of file and credential must be given")
        return self


class SdlsConfig(Section):
    """The authenticated link; roles command and look may have two keys, to replace an old one."""

    spacecraft_id: int = Field(default=42, ge=0, le=1023)
    """spacecraft identifier of the frames"""
    authenticate_spacecraft: bool = True
    """whether frames authenticate the spacecraft too; false: the mask of CCSDS 355.0-B, which lets
    a frame be readdressed to another robot with the same key"""
    virtual_channel: int = Field(default=0, ge=0, le=63)
    """virtual channel of the frames"""
    window: int = Field(default=1024, ge=64)
    """how far ahead of the last one a sequence number may be"""
    keys: Annotated[tuple[SdlsKeyConfig, ...], Field(min_length=1, max_length=5)]

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        numbers = [key.spi for key in self.keys]
        for number in numbers:
            if numbers.count(number) > 1:
                raise ValueError(f"keys.spi: {number} is used twice; must be unique")
        return self

    @model_validator(mode="after")
    def _roles(self) -> Self:
        roles: list[str] = [key.role for key in self.keys]
        for role, least, most in (("command", 1, 2), ("look", 0, 2), ("telemetry", 0, 1)):
            count = roles.count(role)
            if not least <= count <= most:
                raise ValueError(f"keys.role: {count} of {role!r}; must be {least} to {most}")
        return self
