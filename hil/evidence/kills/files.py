"""Checks files after a kill: checkpoints and recordings, read as the daemon reads them."""

from dataclasses import dataclass
from pathlib import Path

from fsw.drivers.wire import unpack_frame
from fsw.exchange.checkpoint import CheckpointError, decode
from fsw.exchange.checkpoint_store import NAMES
from fsw.exchange.recording import messages_of
from fsw.exchange.recording_parts import contents_of
from hil.devices.canopen import SYNC_ID

SYNC_COUNTERS = 240


@dataclass(frozen=True, slots=True, kw_only=True)
class PartState:
    """Contents of one file of a recording."""

    truncated: bool
    first_ns: int
    last_ns: int
    syncs: int
    gaps: int  # breaks of the SYNC counter within the file


def unreadable_checkpoints(state: Path) -> list[str]:
    """Return why a checkpoint cannot be read, one line for each that is there and cannot."""
    faults = []
    for name in NAMES:
        path = state / name
        if path.exists():
            try:
                decode(path.read_bytes())
            except CheckpointError as error:
                faults.append(f"{name}: {error}")
    return faults


def part_state(path: Path, topic: str) -> PartState:
    """Read one file to its end or break. Raises ConfigError when it is no recording at all."""
    held = contents_of([path])
    first_ns = last_ns = syncs = gaps = 0
    counter: int | None = None
    for record in messages_of([path], held.topics):
        first_ns = first_ns or record.t_ns
        last_ns = max(last_ns, record.t_ns)
        frame = unpack_frame(record.t_ns, record.data) if record.topic == topic else None
        if frame is None or frame.can_id != SYNC_ID:
            continue
        gaps += counter is not None and frame.data[0] != counter % SYNC_COUNTERS + 1
        counter = frame.data[0]
        syncs += 1
    return PartState(
        truncated=held.truncated, first_ns=first_ns, last_ns=last_ns, syncs=syncs, gaps=gaps
    )
