"""The reference of a row on a real bus: the clean run without the answers lost in the fault.

An answer is the TPDO1 of a node to a SYNC. A copy of the clean run's recording leaves out the
answers that the faulty run lacks while the fault lasts. A replay of the copy is the reference.
"""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path

from fsw.config import Config
from fsw.drivers.codecs.canopen import COB_SYNC, COB_TPDO1, NODE_MASK
from fsw.drivers.layout.shipped import JOINT, JOINT_FD
from fsw.drivers.wire import ByteChunk, CanFrame, frame_array, unpack_frame
from fsw.exchange.recording import messages_of
from fsw.exchange.recording_parts import contents_of, parts_of
from fsw.exchange.recording_writer import RecordingWriter
from fsw.exchange.sinks import IMU, STAR_TRACKER, CanTraffic, SerialTraffic
from hil.judge.outcome import result_of
from hil.judge.score import Result
from hil.run.collector import Collector
from offline.replay import replay

COMMANDS, SERIAL = "/tc", "/serial/"
Answer = tuple[int, int]  # node; number of the answered SYNC, in periods since the first SYNC


def numbered(
    frames: Iterable[CanFrame], period_ns: int
) -> Iterator[tuple[CanFrame, Answer | None]]:
    """Yield every frame with its answer, or with None if the frame is no answer to a SYNC."""
    first_ns: int | None = None
    numbers: dict[int, int] = {}  # number of the newest SYNC by its counter
    for frame in frames:
        answer = None
        if frame.can_id == COB_SYNC and frame.data:
            first_ns = frame.t_ns if first_ns is None else first_ns
            numbers[frame.data[0]] = round((frame.t_ns - first_ns) / period_ns)
        elif frame.can_id & ~NODE_MASK == COB_TPDO1 and not frame.is_error:
            place, size = (14, JOINT_FD.length) if frame.is_fd else (7, JOINT.length)
            if len(frame.data) == size and frame.data[place] in numbers:
                answer = frame.can_id & NODE_MASK, numbers[frame.data[place]]
        yield frame, answer


def frames_of(recording: Path, bus: str) -> list[CanFrame]:
    """Return all valid frames of a bus in a recording."""
    records = messages_of(parts_of(recording), [f"/can/{bus}"])
    frames = (unpack_frame(record.t_ns, record.data) for record in records)
    return [frame for frame in frames if frame is not None]


def lost(
    clean: Iterable[CanFrame], faulty: Iterable[CanFrame], period_ns: int, span_ns: tuple[int, int]
) -> set[Answer]:
    """Return the answers of the clean run that the faulty run lacks while its fault lasts.

    Parameters
    ----------
    span_ns : begin and end of the fault on the faulty run's clock [ns]
    """
    heard = list(faulty)
    first_ns = next(frame.t_ns for frame in heard if frame.can_id == COB_SYNC)
    first, last = (round((t_ns - first_ns) / period_ns) for t_ns in span_ns)
    had = {answer for _, answer in numbered(clean, period_ns) if answer is not None}
    has = {answer for _, answer in numbered(heard, period_ns) if answer is not None}
    return {answer for answer in had - has if first <= answer[1] <= last}


def without(recording: Path, bus: str, period_ns: int, missing: set[Answer], path: Path) -> None:
    """Write a copy of the topics that a replay needs, without the missing answers."""
    writer = RecordingWriter(path)
    for frame, answer in numbered(frames_of(recording, bus), period_ns):
        if answer not in missing:
            writer.traffic(CanTraffic(bus, frame_array([frame])))
    parts = parts_of(recording)
    topics = [COMMANDS, SERIAL + IMU, SERIAL + STAR_TRACKER]
    held = [topic for topic in topics if topic in contents_of(parts).topics]
    for record in messages_of(parts, held):
        if record.topic == COMMANDS:
            writer.json(COMMANDS, record.t_ns, json.loads(record.data))
        else:
            device = record.topic.removeprefix(SERIAL)
            writer.traffic(SerialTraffic(device, [ByteChunk(record.t_ns, record.data)]))
    writer.close()


def reference(
    clean: Path,
    faulty: Path,
    config: Config,
    span_ns: tuple[int, int],
    folder: Path,
    end_ns: int,
) -> tuple[Result, int]:
    """Return the clean run's result without the missing answers, and the number of these answers.

    Parameters
    ----------
    clean, faulty : recordings of the two runs
    config : configuration of the clean run; the fault acts on its first bus
    span_ns : begin and end of the fault on the faulty run's clock [ns]
    end_ns : time of the result on the clean run's clock [ns]; the last estimate until then counts
    """
    bus = config.buses[0]
    period_ns = round(1e9 / bus.rate_hz)
    missing = lost(frames_of(clean, bus.name), frames_of(faulty, bus.name), period_ns, span_ns)
    path = folder / "reference.mcap"
    without(clean, bus.name, period_ns, missing, path)
    collector = Collector()
    replay(path, config, sink=collector)
    last = next((e for e in reversed(collector.estimates) if e.t_ns <= end_ns), None)
    return result_of(last, config.unknown), len(missing)
