"""Replies that a busy machine holds back for periods, in the order of frames of a recorded flight.

The position of a reply tells the SYNC that it answers; the sample must have the time of that one.
"""

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsw.drivers.wire import CanFrame, frame_array
from fsw.messages import JointSamples, joined
from tests.support.bus_traffic import cut
from tests.unit.fsw.drivers.sources.test_described import PAIR, T0, _rows, made, shared

MS = 1_000_000
PERIOD_NS = 10 * MS
STEP_RAD = np.radians(0.020)
LOST_AFTER_NS = 80 * MS  # a reply that is missing for so long does not come any more
CALM = (1,) * 12
JOINTS = 5
HELD = {  # replies between a SYNC and the next one, as recorded; how many of them are late
    "a period late": ((0, 2), 1),
    "two of them": ((0, 0, 3), 2),
    "late for two periods": ((0, 1, 2), 2),
    "late for three periods": ((0, 1, 1, 2), 3),
    "late again at once": ((0, 1, 2, 0, 2), 3),
}


def source_of(folder: Path, count: int = 1, **timing: Any):
    joints = [shared(0) for _ in range(count)]
    for k, joint in enumerate(joints):
        joint["timing"] |= timing
        joint["signals"]["position"]["message"] = f"pair{k}"
    messages = [PAIR | {"name": f"pair{k}", "id": 0x2A5 + k} for k in range(count)]
    bus = {"messages": messages, "sync": "consumer", "sync_counter_max": 0}
    return made(folder, bus, joints)


def replied(number: int, t_ns: int, joint: int = 0) -> CanFrame:
    return CanFrame(t_ns, 0x2A5 + joint, struct.pack(">ii", 20 * number, 0))


def frames_of(counts: Sequence[int], lost: Sequence[int] = ()) -> list[CanFrame]:
    """Return SYNCs with so many replies after each; replies in `lost` do not come."""
    frames, number = list[CanFrame](), 0
    for k, count in enumerate(counts):
        frames.append(CanFrame(T0 + PERIOD_NS * k, 0x080, b""))
        for place in range(count):
            while number in lost:
                number += 1
            frames.append(replied(number, T0 + PERIOD_NS * k + MS + 100_000 * place))
            number += 1
    return frames


def wrong_ns(samples: JointSamples) -> np.ndarray:
    """Return by how much the time of every sample differs from that of its SYNC."""
    number = np.round(samples.position_rad / STEP_RAD).astype(np.int64)
    return samples.t_ns - T0 - PERIOD_NS * number


@pytest.mark.parametrize("before", [CALM, ()])
@pytest.mark.parametrize("case", HELD)
def test_a_held_reply_has_the_time_of_its_own_sync(tmp_path, case, before):
    counts, late = HELD[case]
    frames = frame_array(frames_of([*before, *counts, *CALM]))
    source, patient = source_of(tmp_path), source_of(tmp_path, latest_s=1.0)
    samples, all_samples = source.feed(frames), patient.feed(frames)
    assert not wrong_ns(samples).any()
    assert not wrong_ns(all_samples).any()
    assert len(all_samples) == len(before) + sum(counts) + len(CALM)
    assert (patient.counters["rejected"], patient.counters["lost"]) == (0, 0)
    assert len(samples) == len(all_samples) - late
    counters = source.counters
    assert counters["rejected"] == counters["reject_stale"] == late
    assert counters["lost"] == late or not before  # none is counted before the first accepted


def test_a_lost_reply_costs_no_other_and_delays_the_next_ones(tmp_path):
    source = source_of(tmp_path)
    frames = frames_of([*CALM, 0, *CALM, *CALM], lost=[12])
    samples = source.feed(frame_array(frames))
    assert not wrong_ns(samples).any()
    assert (len(samples), source.counters["rejected"], source.counters["lost"]) == (36, 0, 1)
    age_ns = samples.t_receive_ns - samples.t_ns
    assert age_ns.max() <= LOST_AFTER_NS + PERIOD_NS
    assert (age_ns[samples.t_ns > T0 + 24 * PERIOD_NS] == MS).all()


def test_two_replies_to_one_sync_do_not_disturb_the_next_ones(tmp_path):
    frames = frames_of([1] * 30)
    frames.insert(21, replied(9, frames[20].t_ns + 2 * MS))
    source = source_of(tmp_path)
    samples = source.feed(frame_array(sorted(frames, key=lambda frame: frame.t_ns)))
    assert not wrong_ns(samples).any()
    assert (len(samples), source.counters["reject_sequence"]) == (30, 1)
    assert (samples.t_receive_ns - samples.t_ns == MS).all()


def stalled(rng: np.random.Generator, count: int, loss: float = 0.0) -> list[CanFrame]:
    """Return the frames of a machine that holds all replies for up to 50 ms, and loses some."""
    free_ns, frames = 0, list[CanFrame]()
    for k in range(count):
        at_ns = T0 + PERIOD_NS * k
        frames.append(CanFrame(at_ns, 0x080, b""))
        if rng.random() < 0.02:
            free_ns = max(free_ns, at_ns + int(rng.integers(5 * MS, 50 * MS)))
        for joint in range(JOINTS):
            free_ns = max(at_ns + 700_000, free_ns) + 100_000
            if rng.random() >= loss:
                frames.append(replied(k, free_ns, joint))
    return sorted(frames, key=lambda frame: frame.t_ns)


@pytest.mark.parametrize("loss", [0.0, 0.02])
@pytest.mark.parametrize("seed", range(5))
def test_no_stall_of_a_machine_dates_a_sample_wrongly(tmp_path, seed, loss):
    source = source_of(tmp_path, JOINTS)
    frames = stalled(np.random.default_rng(seed), 3000, loss)
    samples = source.feed(frame_array(frames))
    assert not wrong_ns(samples).any()
    assert source.counters["reject_stale"] == source.counters["rejected"]
    assert len(samples) > (0.9 - 2 * loss) * 3000 * JOINTS


def test_batches_do_not_matter(tmp_path):
    rng = np.random.default_rng(6)
    frames = stalled(rng, 1000, 0.02)
    whole, parts = source_of(tmp_path, JOINTS), source_of(tmp_path, JOINTS)
    once = whole.feed(frame_array(frames))
    many = joined([parts.feed(frame_array(frames[own])) for own in cut(rng, len(frames), 5.0)])
    assert sorted(_rows(once)) == sorted(_rows(many))
    assert whole.counters == parts.counters
