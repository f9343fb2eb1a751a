"""Sections of the service process: recordings, planning on board, local state."""

from pathlib import Path
from typing import Literal

from pydantic import Field

from fsw.config.base import Duration, NonNegative, Positive, Rate, Section


class RecorderConfig(Section):
    """Recordings; `directory` null: the daemon records nothing."""

    directory: Path | None = None
    compression: Literal["zstd", "lz4", "none"] = "zstd"
    chunk_bytes: int = Field(default=65536, ge=4096)
    part_bytes: int | None = Field(default=1 << 30, ge=65536)  # then a new part begins
    part_s: Positive | None = 3600.0


class ExcitationConfig(Section):
    """Planning of motions on board (`RUN_PLAN`); without this section it is not available."""

    limits: Path
    jobs: int = Field(default=1, ge=1, le=64)  # starts of the search that run in parallel


class ServiceConfig(Section):
    """Local state of the daemon: status file, control socket, checkpoints."""

    state_directory: Path = Path("state")
    status_rate_hz: Rate = 5.0
    checkpoint_period_s: Duration | None = 10.0  # null: no checkpoints
    checkpoint_hold_s: NonNegative = 60.0  # age up to which a checkpoint's biases are used too
