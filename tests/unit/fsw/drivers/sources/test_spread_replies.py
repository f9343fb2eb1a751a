"""Replies of two messages each, held back together, of which single messages are lost.

Position and torque both tell the cue that they answer. A sample must have the time of its position,
and the torque of no other cue.
"""

import itertools
import struct
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsw.drivers.wire import CanFrame, frame_array
from fsw.messages import JointSamples, joined
from tests.support.bus_traffic import cut
from tests.unit.fsw.drivers.sources.test_described import T0, _rows, made, use
from tests.unit.fsw.drivers.sources.test_replies import CALM, HELD, MS, PERIOD_NS

JOINTS = 3
STEP_RAD, STEP_NM = 1e-4, 1e-2
POSITION_ID, TORQUE_ID = 0x2A5, 0x3A5
ORDERS = ("PT", "TP")
Slot = tuple[str, int]  # which message, answer to which cue


def source_of(folder: Path, count: int = 1, **timing: Any):
    messages, joints = [], []
    for k in range(count):
        for name, first, step in (("p", POSITION_ID, STEP_RAD), ("t", TORQUE_ID, STEP_NM)):
            signal = {"name": "v", "start": 0, "bits": 32, "number": "signed", "scale": step}
            own = {"name": f"{name}{k}", "id": first + k, "length": 4, "signals": [signal]}
            messages.append(own)
        signals = {
            "position": use(f"p{k}", "v", unit="rad"),
            "torque": use(f"t{k}", "v", unit="nm"),
        }
        limits = {"torque_limit_nm": 1e4, "speed_limit_rad_s": 3.0}
        joints.append(limits | {"signals": signals, "timing": {"by": "last_sync"} | timing})
    bus = {"messages": messages, "sync": "consumer", "sync_counter_max": 0}
    return made(folder, bus, joints)


def message(slot: Slot, t_ns: int, joint: int = 0) -> CanFrame:
    name, number = slot
    first = POSITION_ID if name == "P" else TORQUE_ID
    return CanFrame(t_ns, first + joint, struct.pack("<i", number))


def frames_of(
    counts: Sequence[int], order: str = "PT", lost: Iterable[Slot] = (), parted: Iterable[int] = ()
) -> list[CanFrame]:
    """Return SYNCs with the answers that come after each: to so many of the cues before.

    A message in `lost` does not come. The last one after a SYNC in `parted` comes after the next.
    """
    frames, number, left = list[CanFrame](), 0, list[Slot]()
    for k, count in enumerate(counts):
        at_ns = T0 + PERIOD_NS * k
        frames.append(CanFrame(at_ns, 0x080, b""))
        left += [(name, number + place) for place in range(count) for name in order]
        number += count
        end = len(left) - (k in set(parted))
        now, left = left[:end], left[end:]
        own = [slot for slot in now if slot not in set(lost)]
        frames += [message(slot, at_ns + MS + 100_000 * i) for i, slot in enumerate(own)]
    return frames


def wrong(samples: JointSamples) -> tuple[np.ndarray, np.ndarray]:
    """Return how far times and torques are from those that belong to the positions."""
    number = np.round(samples.position_rad / STEP_RAD)
    of_torque = np.round(samples.torque_nm / STEP_NM)
    return samples.t_ns - T0 - PERIOD_NS * number, np.nan_to_num(of_torque - number)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("case", HELD)
def test_no_message_that_is_lost_in_a_bunch_joins_parts_of_two_cues(tmp_path, case, order):
    counts, _ = HELD[case]
    first, count = len(CALM), sum(counts)
    for lost in itertools.product("PT", range(first, first + count)):
        for latest_s in (None, 1.0):
            source = source_of(tmp_path, latest_s=latest_s)
            frames = frames_of([*CALM, *counts, *CALM], order, [lost])
            samples = source.feed(frame_array(frames))
            late_ns, other = wrong(samples)
            assert not late_ns.any(), lost
            assert not other.any(), lost
        assert source.counters["rejected"] == 0, lost
        assert len(samples) == 2 * len(CALM) + count - (lost[0] == "P"), lost


@pytest.mark.parametrize("is_parted", [False, True])
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("case", HELD)
def test_where_nothing_is_lost_every_sample_is_whole(tmp_path, case, order, is_parted):
    counts = (*CALM[:is_parted], *HELD[case][0])
    source = source_of(tmp_path, latest_s=1.0)
    parted = range(len(CALM), len(CALM) + len(counts)) if is_parted else ()
    samples = source.feed(frame_array(frames_of([*CALM, *counts, *CALM], order, (), parted)))
    assert len(samples) == 2 * len(CALM) + sum(counts)
    assert not np.isnan(samples.torque_nm).any()
    assert not any(column.any() for column in wrong(samples))
    counters = source.counters
    assert (counters["rejected"], counters["lost"], counters["incomplete"]) == (0, 0, 0)


@pytest.mark.parametrize("order", ORDERS)
def test_in_calm_a_lost_message_costs_its_own_sample_only(tmp_path, order):
    source = source_of(tmp_path)
    lost = [("T", 20), ("P", 30)]
    samples = source.feed(frame_array(frames_of([1] * 60, order, lost)))
    assert not any(column.any() for column in wrong(samples))
    counters = source.counters
    assert (len(samples), counters["rejected"], counters["lost"]) == (59, 0, 1)
    assert (counters["torque_unusable"], counters["incomplete"]) == (1, 1)


@pytest.mark.parametrize("order", ORDERS)
def test_a_torque_with_every_second_position_only_is_used(tmp_path, order):
    source = source_of(tmp_path)
    lost = [("T", k) for k in range(13, 59, 2)]
    samples = source.feed(frame_array(frames_of([1] * 60, order, lost)))
    assert not any(column.any() for column in wrong(samples))
    assert (len(samples), source.counters["rejected"]) == (60, 0)
    assert np.isnan(samples.torque_nm).sum() == len(lost)
    assert (samples.t_receive_ns - samples.t_ns).max() <= 2 * PERIOD_NS


def stalled(
    rng: np.random.Generator, count: int, loss: float, orders: Sequence[str]
) -> list[CanFrame]:
    """Return the frames of a machine that holds all replies for up to 50 ms, and loses some."""
    free_ns, frames = 0, list[CanFrame]()
    for k in range(count):
        at_ns = T0 + PERIOD_NS * k
        frames.append(CanFrame(at_ns, 0x080, b""))
        for joint in range(JOINTS):
            for name in orders[joint]:
                if rng.random() < 0.01:
                    free_ns = max(free_ns, at_ns + int(rng.integers(5 * MS, 50 * MS)))
                free_ns = max(at_ns + 700_000, free_ns) + 100_000
                if rng.random() >= loss:
                    frames.append(message((name, k), free_ns, joint))
    return sorted(frames, key=lambda frame: frame.t_ns)


@pytest.mark.parametrize("loss", [0.0, 0.02])
@pytest.mark.parametrize("seed", range(3))
def test_no_stall_of_a_machine_dates_or_joins_wrongly(tmp_path, seed, loss):
    rng = np.random.default_rng(seed)
    orders = [str(rng.choice(ORDERS)) for _ in range(JOINTS)]
    source = source_of(tmp_path, JOINTS)
    samples = source.feed(frame_array(stalled(rng, 2000, loss, orders)))
    assert not any(column.any() for column in wrong(samples))
    assert len(samples) > (0.8 - 3 * loss) * 2000 * JOINTS


@pytest.mark.parametrize("loss", [0.0, 0.02])
def test_batches_do_not_matter(tmp_path, loss):
    rng = np.random.default_rng(7)
    frames = stalled(rng, 1000, loss, ["PT", "TP", "PT"])
    whole, parts = source_of(tmp_path, JOINTS), source_of(tmp_path, JOINTS)
    once = whole.feed(frame_array(frames))
    many = joined([parts.feed(frame_array(frames[own])) for own in cut(rng, len(frames), 5.0)])
    assert sorted(_rows(once)) == sorted(_rows(many))
    assert whole.counters == parts.counters


def calls_of(source, frames: Sequence[CanFrame], batch: int) -> int:
    """Return the number of calls that a source makes for frames in batches."""
    calls, parts = (
        itertools.count(),
        [frame_array(frames[at : at + batch]) for at in range(0, len(frames), batch)],
    )
    sys.setprofile(lambda *event: event[1] in ("call", "c_call") and next(calls))
    try:
        for part in parts:
            source.feed(part)
    finally:
        sys.setprofile(None)
    return next(calls)


def test_a_lost_message_costs_about_what_the_messages_held_for_it_cost(tmp_path):
    frames = frames_of([1] * 200)
    whole = calls_of(source_of(tmp_path), frames, 10)
    lost = calls_of(source_of(tmp_path), frames_of([1] * 200, "PT", [("P", 100)]), 10)
    held = 2 * int(0.08e9 / PERIOD_NS)
    assert lost - whole < 25 * held
