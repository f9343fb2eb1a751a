"""Sections of the service process: recordings, planning on board, local state."""

from pathlib import Path
from typing import Literal

from pydantic import Field

from fsw.config.base import Duration, NonNegative, Section

CHUNKS_IN_RESERVE = 4  # a recording that ends for want of room writes its last chunk and an index


class RecorderConfig(Section):
    """Recordings; `directory` null: the daemon records nothing."""

    directory: Path | None = None
    compression: Literal["zstd", "lz4", "none"] = "zstd"
    chunk_bytes: int = Field(default=65536, ge=4096, le=1 << 24)
    part_bytes: int | None = Field(default=1 << 30, ge=65536)  # then a new part begins, if the
    # part has lasted a second
    part_s: float | None = Field(default=3600.0, ge=1.0, le=1e7, allow_inf_nan=False)


class ExcitationConfig(Section):
    """Planning of motions on board (`RUN_PLAN`); without this section it is not available."""

    limits: Path
    jobs: int = Field(default=1, ge=1, le=64)  # starts of the search that run in parallel


class ServiceConfig(Section):
    """Local state of the daemon: status file, control socket, checkpoints."""

    state_directory: Path = Path("state")
    status_rate_hz: float = Field(default=5.0, gt=0, le=100.0, allow_inf_nan=False)
    checkpoint_period_s: Duration | None = 10.0  # null: no checkpoints
    disk_reserve_bytes: int = Field(default=4 << 20, ge=1 << 18, le=1 << 34)  # left free by
    # recordings, uploads and packet stores; half of it also by logs
    checkpoint_hold_s: NonNegative = 60.0  # age up to which a checkpoint's biases are used too


def reserve_holds_chunks(recorder: RecorderConfig, service: ServiceConfig) -> None:
    """Raise ValueError if the reserve of the disk cannot hold the last chunk of a recording."""
    least = CHUNKS_IN_RESERVE * recorder.chunk_bytes
    if service.disk_reserve_bytes < least:
        raise ValueError(
            f"service.disk_reserve_bytes: {service.disk_reserve_bytes} must be at least {least}, "
            f"{CHUNKS_IN_RESERVE} recorder.chunk_bytes"
        )
