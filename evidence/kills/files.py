"""Check checkpoints and recordings after a kill, read with the daemon's own functions."""

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
    """The state of one file of a recording."""

    truncated: bool  # whether the end record is missing
    first_ns: int  # time of the first record
    last_ns: int  # newest time of all records
    syncs: int  # number of SYNC frames
    gaps: int  # breaks of the SYNC counter within the file


def unreadable_checkpoints(state: Path) -> list[str]:
    """Return a line with the reason for every existing checkpoint that cannot be read."""
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
    """Read one file to its end or break. Raises ConfigError if the file is not a recording."""
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
