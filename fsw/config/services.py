"""What the daemon keeps and offers: recordings, local state."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from fsw.config.base import Positive, Section


class RecorderConfig(Section):
    """Where recordings go; null directory: none."""

    directory: Path | None = None
    compression: Literal["zstd", "lz4", "none"] = "zstd"
    chunk_bytes: int = Field(default=65536, ge=4096)


class ServiceConfig(Section):
    """Local state of the daemon: status file, control socket, checkpoints."""

    state_directory: Path
    status_rate_hz: Positive = 5.0
