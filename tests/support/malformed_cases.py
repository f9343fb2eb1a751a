"""Recordings with malformed input, and the same recordings without it.

The reference keeps what the device really sent, intact, once and in its order, and drops every
other byte and frame; the stamps stay. It is made without the flight software's codecs.
"""

import dataclasses
import json
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from fsw.config import Config
from fsw.drivers.wire import (
    ByteChunk,
    CanFrame,
    FrameArray,
    frame_list,
    frames_from,
    pack_frame,
)
from fsw.exchange.recording import RecordedMessage, messages
from fsw.exchange.recording_writer import RecordingWriter
from fsw.exchange.sinks import CanTraffic, SerialTraffic
from fsw.messages import Block, Estimate
from hil.judge.score import normalised_error_squared
from hil.links.virtual import VirtualBench
from hil.run import bench
from hil.run.collector import Collector
from hil.world.inertia import pi_of
from hil.world.scenario import load
from offline.replay import replay

ARM, IMU, TRACKER = "/can/arm", "/serial/imu", "/serial/star_tracker"
BEFORE_S = 1.0
TOTAL_S = 11.0
CHI2_10_999 = 29.6  # 99.9 % bound of chi-squared with 10 degrees of freedom
SAME = 1e-12  # of its own value or sigma: the bound
CHANNELS = ("q_rad", "qd_rad_s", "qdd_rad_s2", "tau_nm", "w_NB_B_rad_s", "f_NS_B_m_s2", "R_NB")
Items = Sequence[tuple[Any, ...]]


class Quiet:
    """A meter nobody looks at."""

    def update(self, done_s: float, summary: Mapping[str, Any] | None) -> None:
        pass


def conserved(counters: Mapping[str, int]) -> bool:
    held = counters["accepted_bytes"] + counters["rejected_bytes"] + counters["skipped_bytes"]
    return held + counters.get("pending_bytes", 0) == counters["received_bytes"]


def short(folder: Path, seed: int = 1, total_s: float = TOTAL_S) -> bench.Setup:
    """Return the first seconds of a motion with an unknown target, after a second of rest."""
    scenario = load("target_leo")
    scenario = dataclasses.replace(scenario, before_s=BEFORE_S)
    setup = bench.prepare(scenario, seed, folder)
    after_s = scenario.after_s - (setup.total_s - total_s)
    return dataclasses.replace(setup, scenario=dataclasses.replace(scenario, after_s=after_s))


def fly(
    setup: bench.Setup, disturb: Callable[[VirtualBench], None] | None = None
) -> bench.Recorded:
    """Return a recorded run in virtual time."""
    return bench.run_virtual(setup, Quiet(), record=True, disturb=disturb)


def normalised_error(setup: bench.Setup, mean: np.ndarray, covariance: np.ndarray) -> float:
    """Return the squared normalised error of the target's ten parameters."""
    truth = pi_of(setup.scenario.truth["target"])
    return normalised_error_squared(mean[:10] - truth, covariance[:10, :10])


@dataclass(frozen=True)
class Replayed:
    """What a replay gave."""

    estimate: Estimate
    blocks: list[Block]
    codes: list[str]
    samples: Mapping[str, Mapping[str, int]]
    windows: Mapping[str, int]


def run(path: Path, config: Config) -> Replayed:
    sink = Collector()
    result = replay(path, config, sink=sink)
    assert result.estimate is not None
    status = result.status
    return Replayed(result.estimate, sink.blocks, sink.codes, status["samples"], status["windows"])


def read(path: Path) -> list[RecordedMessage]:
    """Return all that a replay needs of a recording."""
    return list(messages(path, [ARM, IMU, TRACKER, "/tc"]))


def write(path: Path, records: Sequence[RecordedMessage]) -> Path:
    """Write a recording; the chunks and frames keep their order."""
    writer = RecordingWriter(path)
    for topic, run in groupby(records, key=lambda record: record.topic):
        own = list(run)
        if topic == ARM:
            writer.traffic(CanTraffic("arm", frames_of(own)))
        elif topic == "/tc":
            for record in own:
                writer.json("/tc", record.t_ns, json.loads(record.data))
        else:
            chunks = [ByteChunk(record.t_ns, record.data) for record in own]
            writer.traffic(SerialTraffic(topic.removeprefix("/serial/"), chunks))
    writer.close()
    return path


def frames_of(records: Sequence[RecordedMessage]) -> FrameArray:
    """Return the frames of records of the arm's bus; every one of them is a classic frame."""
    stamps_ns = np.array([record.t_ns for record in records])
    rows = np.frombuffer(b"".join(record.data for record in records), np.uint8)
    rows = rows.reshape(len(records), -1)
    frames = frames_from(stamps_ns, rows, np.full(len(records), rows.shape[1]))
    assert len(frames) == len(records)
    return frames


def tapped(
    records: Sequence[RecordedMessage], taps: Mapping[str, Callable[[Items], Items]]
) -> list[RecordedMessage]:
    """Return the records after each topic's tap; SYNC and what the host sent pass untouched."""
    out = []
    frames = iter(frame_list(frames_of([record for record in records if record.topic == ARM])))
    for record in records:
        tap = taps.get(record.topic)
        frame = next(frames) if record.topic == ARM else None
        if tap is None or (frame is not None and frame.can_id <= 0x080):
            out.append(record)
        elif frame is not None:
            item = (frame.t_ns, frame.can_id, frame.data, frame.is_fd)
            tapped_items = tap([item])
            if list(tapped_items) == [item]:
                out.append(record)
                continue
            for t_ns, can_id, data, is_fd in tapped_items:
                changed = CanFrame(t_ns, can_id, data, is_fd)
                out.append(RecordedMessage(t_ns, (), ARM, pack_frame(changed)))
        else:
            out += [
                RecordedMessage(t_ns, (), record.topic, data)
                for t_ns, data in tap([(record.t_ns, record.data)])
            ]
    return sorted(out, key=lambda record: record.t_ns)


def lacking(
    records: Sequence[RecordedMessage], clean: Sequence[RecordedMessage]
) -> list[RecordedMessage]:
    """Return the records without every byte and frame the devices did not send themselves.

    `clean` is the same traffic before it was disturbed, one transmission per record.
    """
    out = [r for r in records if r.topic == "/tc"]
    frames = defaultdict(int)
    for record in clean:
        if record.topic == ARM:
            frames[record.t_ns, record.data] += 1
    for record in records:
        if record.topic == ARM and frames[record.t_ns, record.data] > 0:
            frames[record.t_ns, record.data] -= 1
            out.append(record)
    for topic in (IMU, TRACKER):
        sent = [r.data for r in clean if r.topic == topic]
        out += _intact([r for r in records if r.topic == topic], sent)
    return sorted(out, key=lambda record: record.t_ns)


def _intact(chunks: Sequence[RecordedMessage], sent: Sequence[bytes]) -> Iterator[RecordedMessage]:
    """Yield the chunks with nothing but whole transmissions, each at most once, in order."""
    stream = b"".join(chunk.data for chunk in chunks)
    index = {data: k for k, data in enumerate(sent)}
    assert len(index) == len(sent)
    lengths = sorted({len(data) for data in sent}, reverse=True)
    keep = np.zeros(len(stream), dtype=bool)
    at, newest = 0, -1
    while at < len(stream):
        for length in lengths:
            k = index.get(stream[at : at + length], -1)
            if k > newest:
                keep[at : at + length] = True
                newest = k
                at += length
                break
        else:
            at += 1
    at = 0
    for chunk in chunks:
        held = keep[at : at + len(chunk.data)]
        at += len(chunk.data)
        data = bytes(np.frombuffer(chunk.data, np.uint8)[held])
        if data:
            yield RecordedMessage(chunk.t_ns, (), chunk.topic, data)


def differences(a: Replayed, b: Replayed) -> dict[str, float]:
    """Return the largest difference: of the mean in sigmas, of sigma and of the blocks' values."""
    sigma = np.sqrt(np.diag(b.estimate.covariance))
    found = {
        "mean": float(np.max(np.abs(a.estimate.mean - b.estimate.mean) / sigma)),
        "sigma": float(np.max(np.abs(np.sqrt(np.diag(a.estimate.covariance)) / sigma - 1))),
        "blocks": float(abs(len(a.blocks) - len(b.blocks))),
    }
    for name in (
        "q_rad",
        "qd_rad_s",
        "qdd_rad_s2",
        "tau_nm",
        "w_NB_B_rad_s",
        "f_NS_B_m_s2",
        "R_NB",
    ):
        pairs = zip(a.blocks, b.blocks, strict=False)
        found[name] = max(
            float(np.max(np.abs(getattr(x, name) - getattr(y, name)))) for x, y in pairs
        )
    return found
