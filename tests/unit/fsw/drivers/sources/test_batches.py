"""Whatever comes in batches gives the same as one by one, however it is cut."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsw.drivers.sources.imu import ImuSource
from fsw.drivers.sources.joint_track import JointTrack
from fsw.drivers.sources.joints import JointBusSource
from fsw.drivers.sources.star_tracker import StarTrackerSource
from fsw.drivers.wire import ByteChunk, CanFrame, frame_array
from tests.support import serial_line as lines
from tests.support.bus_traffic import FD_NODE, KINDS, NODES, Struck, cut, struck, traffic
from tests.support.driver_configs import (
    bus_config,
    imu_config,
    joint_config,
    star_tracker_config,
)
from tests.support.encoders import solution
from tests.support.samples import plain

seeds = st.integers(0, 2**32 - 1)


def bus() -> JointBusSource:
    joints = [
        (k, joint_config(node, format="fd" if node == FD_NODE else "classic"))
        for k, node in enumerate(NODES)
    ]
    return JointBusSource(bus_config(fd=True), joints)


def heard(frames: Sequence[CanFrame], batches: Sequence[slice]) -> dict[str, Any]:
    """Return everything a source makes of frames that come in these batches."""
    source = bus()
    samples, findings, events = [], [], []
    array = frame_array(frames)
    for batch in batches:
        samples += plain(source.feed(array[batch].copy()))
        findings += source.findings()
        events += source.events()
    return {
        "samples": samples,
        "findings": sorted(findings, key=str),
        "events": events,
        "counters": source.counters,
        "joints": source.joint_counters,
        "states": source.node_states,
        "motors": source.motor_side(),
    }


def check(frames: Sequence[CanFrame], rng: np.random.Generator) -> dict[str, Any]:
    """Require the same of single frames, of all at once and of random batches."""
    count = len(frames)
    single = heard(frames, [slice(k, k + 1) for k in range(count)])
    for batches in ([slice(0, count)], cut(rng, count, 60.0)):
        together = heard(frames, batches)
        for key, value in single.items():
            assert together[key] == value, key
    return single


@settings(max_examples=15, deadline=None)
@given(seeds, st.integers(0, 12))
def test_joints_do_not_depend_on_how_their_frames_are_cut(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    check(traffic(rng, 200, struck(rng, 200, count)), rng)


@pytest.mark.parametrize("kind", KINDS)
def test_no_fault_depends_on_how_its_frames_are_cut(kind: str) -> None:
    rng = np.random.default_rng(7)
    faults = [Struck(kind, NODES[1], 90, 97), Struck(kind, NODES[2], 160, 161)]
    check(traffic(rng, 200, faults), rng)


def test_a_batch_of_many_syncs_forgets_no_loss_and_invents_none() -> None:
    rng = np.random.default_rng(3)
    frames = traffic(rng, 700, [Struck("silent", NODES[1], at, at + 3) for at in (60, 250, 400)])
    short = heard(frames, [slice(k, k + 40) for k in range(0, len(frames), 40)])
    whole = heard(frames, [slice(0, len(frames))])
    assert whole == short
    assert whole["joints"][1]["lost"] == 9


@pytest.fixture
def judged(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Samples that are judged one by one, call by call."""
    judged: list[int] = []
    judge = JointTrack.judge

    def spy(track: JointTrack, syncs: Sequence[int], *columns: Any) -> Any:
        judged.append(len(syncs))
        return judge(track, syncs, *columns)

    monkeypatch.setattr(JointTrack, "judge", spy)
    return judged


def test_a_fault_costs_the_part_of_a_long_batch_that_it_lies_in(judged: list[int]) -> None:
    """The first part of each joint too, and that in which it begins to move."""
    frames = traffic(np.random.default_rng(6), 480, [Struck("silent", NODES[1], 300, 302)])
    single = heard(frames, [slice(k, k + 1) for k in range(len(frames))])
    judged.clear()
    assert heard(frames, [slice(0, len(frames))]) == single
    assert single["joints"][1]["lost"] == 2
    assert sum(judged) < len(NODES) * 480 / 2


def test_a_bus_without_faults_finds_none_and_judges_no_sample_alone(judged: list[int]) -> None:
    """The other tests would say nothing about whole batches if none were judged as a whole."""
    rng = np.random.default_rng(5)
    frames = traffic(rng, 600, [])
    source = bus()
    findings = []
    for start in range(0, len(frames), 80):
        source.feed(frame_array(frames[start : start + 80]))
        findings += source.findings()
    assert findings == []
    assert source.counters["accepted"] == source.counters["received"] == 1800
    assert sum(judged) < 200


class Unit:
    """Chunks of a serial device, and the source that decodes them."""

    def __init__(self, chunks: Sequence[ByteChunk], make: Any) -> None:
        self.chunks, self.make = chunks, make

    def heard(self, batches: Sequence[slice]) -> dict[str, Any]:
        source = self.make()
        samples = []
        findings = []
        for batch in batches:
            samples += plain(source.feed(self.chunks[batch]))
            findings += source.findings()
        return {"samples": samples, "findings": findings, "counters": source.counters}

    def check(self, rng: np.random.Generator) -> dict[str, Any]:
        count = len(self.chunks)
        single = self.heard([slice(k, k + 1) for k in range(count)])
        for batches in ([slice(0, count)], cut(rng, count, 3.0), cut(rng, count, 30.0)):
            assert self.heard(batches) == single
        return single


def spoiled(chunks: Sequence[ByteChunk], rng: np.random.Generator, rate: float) -> list[ByteChunk]:
    """Return chunks of which some are lost, doubled, damaged, late or full of junk."""
    found = []
    late_ns = 0
    for chunk in chunks:
        t_ns, data = chunk.t_ns, chunk.data
        late_ns = max(0, late_ns - 500_000)
        if rng.random() < rate:
            kind = int(rng.integers(0, 5))
            if kind == 0:
                continue
            if kind == 1:
                data = data + data
            elif kind == 2:
                bad = bytearray(data)
                bad[int(rng.integers(0, len(bad)))] ^= 1 << int(rng.integers(0, 8))
                data = bytes(bad)
            elif kind == 3:
                late_ns = int(rng.integers(1, 30)) * 1_000_000
            else:
                data = rng.bytes(int(rng.integers(1, 90))) + data
        found.append(ByteChunk(max(t_ns + late_ns, found[-1].t_ns if found else 0), data))
    return found


@settings(max_examples=12, deadline=None)
@given(seeds, st.sampled_from([0.0, 0.02, 0.2]))
def test_an_inertial_unit_does_not_depend_on_how_its_chunks_are_handed_over(
    seed: int, rate: float
) -> None:
    rng = np.random.default_rng(seed)
    line = lines.Line(0.6, 30.0, rng)
    chunks = line.chunks(lines.grid(1.7e6, 400e3)(line.byte_ns, line.size, rng))
    found = Unit(spoiled(chunks, rng, rate), lambda: ImuSource(imu_config())).check(rng)
    assert len(found["samples"]) > 100


@settings(max_examples=12, deadline=None)
@given(seeds, st.sampled_from([0.0, 0.02, 0.2]), st.sampled_from(["unit", "arrival"]))
def test_a_star_tracker_does_not_depend_on_how_its_chunks_are_handed_over(
    seed: int, rate: float, time: str
) -> None:
    rng = np.random.default_rng(seed)
    q = (0.5, -0.5, 0.5, 0.5)
    chunks = [
        ByteChunk(10**12 + 100_000_000 * k, solution(q, ticks=k, unix_us=10**15 + 100_000 * k))
        for k in range(60)
    ]
    config = star_tracker_config(time=time)
    found = Unit(spoiled(chunks, rng, rate), lambda: StarTrackerSource(config)).check(rng)
    assert len(found["samples"]) > 20
