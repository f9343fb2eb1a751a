"""Sections of the service process: recordings, planning on board, local state."""

from pathlib import Path
from typing import Literal

from pydantic import Field

from fsw.config.base import Duration, NonNegative, Section

CHUNKS_IN_RESERVE = 4  # a recording that ends for want of room writes its last chunk and an index


class RecorderConfig(Section):
    """Recordings; `directory` null: the daemon records nothing."""

    directory: Path | None = None
    """where recordings go; null: none are made"""
    compression: Literal["zstd", "lz4", "none"] = "zstd"
    """of MCAP chunks"""
    chunk_bytes: int = Field(default=65536, ge=4096, le=1 << 24)
    """size of MCAP chunks before compression"""
    part_bytes: int | None = Field(default=1 << 30, ge=65536)
    """a recording continues in a new file once it is this large; null: never"""
    part_s: float | None = Field(default=3600.0, ge=1.0, le=1e7, allow_inf_nan=False)
    """likewise once it is this long; no part is shorter than a second"""


class ExcitationConfig(Section):
    """Planning of motions on board (`RUN_PLAN`); without this section it is not available."""

    limits: Path
    """limits file of motions planned on board ([excitation.md](excitation.md))"""
    jobs: int = Field(default=1, ge=1, le=64)
    """starts of the search side by side, each in a process of the lowest priority"""


class ServiceConfig(Section):
    """Local state of the daemon: status file, control socket, checkpoints."""

    state_directory: Path = Path("state")
    """status file, control socket, checkpoints; at most 87 bytes long"""
    status_rate_hz: float = Field(default=5.0, gt=0, le=100.0, allow_inf_nan=False)
    """how often the status file is replaced"""
    checkpoint_period_s: Duration | None = 10.0
    """how often the estimator's state is written, and the most that a crash loses; null: no
    checkpoints"""
    disk_reserve_bytes: int = Field(default=4 << 20, ge=1 << 18, le=1 << 34)
    """space of the disk that recordings, uploads and packet stores leave free, and logs half of it;
    at least 4 `recorder.chunk_bytes`; see [restart.md](restart.md)"""
    checkpoint_hold_s: NonNegative = 60.0
    """a restart within this time continues exactly where the checkpoint was; a later one, or one
    after a boot, keeps the bodies only and lets the sensors' biases be new"""


def reserve_holds_chunks(recorder: RecorderConfig, service: ServiceConfig) -> None:
    """Raise ValueError if the reserve of the disk cannot hold the last chunk of a recording."""
    least = CHUNKS_IN_RESERVE * recorder.chunk_bytes
    if service.disk_reserve_bytes < least:
        raise ValueError(
            f"service.disk_reserve_bytes: {service.disk_reserve_bytes} must be at least {least}, "
            f"{CHUNKS_IN_RESERVE} recorder.chunk_bytes"
        )
