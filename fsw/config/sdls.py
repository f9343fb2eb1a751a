"""Keys of the authenticated uplink."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from fsw.config.base import Section


class SdlsKeyConfig(Section):
    """One key slot: a file of mode 0600, or a systemd credential; 32 bytes."""

    spi: int = Field(ge=1, le=65534)
    file: Path | None = None
    credential: str | None = None

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        if (self.file is None) == (self.credential is None):
            raise ValueError("one of file and credential must be given")
        return self


class SdlsConfig(Section):
    """The authenticated uplink; two slots, so that a new key can take over from an old one."""

    spacecraft_id: int = Field(default=42, ge=0, le=1023)
    virtual_channel: int = Field(default=0, ge=0, le=63)
    window: int = Field(default=1024, ge=64)
    keys: Annotated[tuple[SdlsKeyConfig, ...], Field(min_length=1, max_length=2)]

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        numbers = [key.spi for key in self.keys]
        if len(set(numbers)) < len(numbers):
            raise ValueError(f"keys.spi: {numbers[0]} is used twice; must be unique")
        return self
