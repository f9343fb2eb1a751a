"""Sections of the service process: recordings, local state."""

from pathlib import Path
from typing import Literal

from pydantic import Field

from fsw.config.base import Duration, NonNegative, Positive, Rate, Section


class RecorderConfig(Section):
    """Directory of the recordings; null: nothing is recorded."""

    directory: Path | None = None
    compression: Literal["zstd", "lz4", "none"] = "zstd"
    chunk_bytes: int = Field(default=65536, ge=4096)
    part_bytes: int | None = Field(default=1 << 30, ge=65536)  # a recording continues in a new file
    part_s: Positive | None = 3600.0


class ExcitationConfig(Section):
    """Motions planned on board (`RUN_PLAN`); without this section none is planned."""

    limits: Path
    jobs: int = Field(default=1, ge=1, le=64)  # starts side by side


class ServiceConfig(Section):
    """Local state of the daemon: status file, control socket, checkpoints."""

    state_directory: Path = Path("state")
    status_rate_hz: Rate = 5.0
    checkpoint_period_s: Duration | None = 10.0  # null: none are made, none is read
    checkpoint_hold_s: NonNegative = 60.0  # biases are taken for the same so long after
