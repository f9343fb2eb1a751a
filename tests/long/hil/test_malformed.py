"""Malformed input through the whole daemon: rejected, counted, and without any trace."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsw.drivers.codecs import sagitta as flight_sagitta
from fsw.drivers.codecs import stim300 as flight_stim300
from fsw.drivers.codecs.sagitta import SagittaCodec
from fsw.drivers.codecs.stim300 import Stim300Codec, StimDatagram
from fsw.drivers.layout.shipped import READ_JOINT
from fsw.drivers.sources import StarTrackerSource
from fsw.drivers.wire import ByteChunk, frame_list
from fsw.exchange.recording import RecordedMessage
from hil.devices import canopen, sagitta, stim300
from hil.faults import taps as faults
from hil.faults.taps import (
    Struck,
    as_node,
    chain,
    change_frame,
    is_tpdo1,
    rewrite,
    stim_fields,
)
from hil.run.bench import Recorded, Setup
from tests.support import malformed_cases as cases
from tests.support.malformed_cases import (
    ARM,
    CHI2_10_999,
    IMU,
    SAME,
    TRACKER,
    Replayed,
    conserved,
    frames_of,
)
from tests.support.plant_cases import reading
from tests.support.taps import FlipEveryBit, Regrouped, flip_payload, forge, sagitta_fields

LINKS = {IMU: "imu", TRACKER: "star_tracker", ARM: "arm"}
REJECTS = ("sync", "length", "crc", "sequence", "range", "status", "node", "stale")
FRAMING = {"sync", "crc"}  # which of the two depends on what the junk looks like
RAW_MAX = 2**23 - 1

# kind: fault and reasons of inertial unit, star tracker, joint nodes
KINDS: dict[str, tuple[tuple[Any, set[str]], ...]] = {
    "noise between frames, node not configured": (
        (faults.noise(40), FRAMING),
        (faults.noise(40), FRAMING),
        (as_node(0x33), {"node"}),
    ),
    "end missing, short frame": (
        (faults.truncate, FRAMING),
        (faults.truncate, FRAMING),
        (change_frame(length=5), {"length"}),
    ),
    "beginning missing, empty frame": (
        (faults.behead, FRAMING),
        (faults.behead, FRAMING),
        (change_frame(length=0), {"length"}),
    ),
    "duplicated": (
        (faults.duplicate, {"sequence"}),
        (faults.duplicate, {"sequence"}),
        (faults.duplicate, {"sequence"}),
    ),
    "counter behind": (
        (rewrite(stim_fields(counter_step=-40)), {"sequence"}),
        (rewrite(sagitta_fields(time_step_us=-300_000)), {"sequence"}),
        (change_frame(counter_step=-7), {"sequence"}),
    ),
    "counter ahead": (
        (rewrite(stim_fields(counter_step=4)), {"sequence"}),
        (rewrite(sagitta_fields(time_step_us=300_000)), {"sequence"}),
        (change_frame(counter_step=7), {"stale"}),
    ),
    "bits flipped, encoder at fault": (
        (faults.flip, FRAMING),
        (faults.flip, FRAMING),
        (change_frame(status=0x19), {"status"}),
    ),
    "forged behind the true one, another node's identifier": (
        (forge(stim_fields(counter_step=1)), {"sequence"}),
        (forge(sagitta_fields(time_step_us=100)), {"sequence"}),
        (as_node(0x13), {"sequence", "range"}),
    ),
    "absurd rate, quaternion, position": (
        (rewrite(stim_fields(gyro=(RAW_MAX, 0, 0))), {"range"}),
        (rewrite(sagitta_fields(q_wxyz=(1.0, 1.0, 0.0, 0.0))), {"range"}),
        (change_frame(position=2**31 - 1), {"range"}),
    ),
    "absurd force, wrong address, absurd torque": (
        (rewrite(stim_fields(acc=(0, -RAW_MAX, 5))), {"range"}),
        (rewrite(sagitta_fields(address=0x22)), {"node"}),
        (change_frame(torque=32000), {"range"}),
    ),
    "latency that moves time by 8 ms, wrong length, half a turn": (
        (rewrite(stim_fields(latency_us=9000)), {"range"}),
        (rewrite(sagitta_fields(cut=3)), {"length"}),
        (change_frame(position=2**23), {"range"}),
    ),
}
# with one or two datagrams to a chunk. Not those whose counter is a whole sample ahead: a chunk
# that late could as well hold the datagram after a lost one.
GROUPED = {
    "end missing, short frame",
    "duplicated",
    "bits flipped, encoder at fault",
    "absurd rate, quaternion, position",
    "latency that moves time by 8 ms, wrong length, half a turn",
}
# whose arm is struck at most once a second: more often, two nodes of one identifier are at work
RARE = {"forged behind the true one, another node's identifier"}


@dataclasses.dataclass(frozen=True)
class Clean:
    """An undisturbed run."""

    setup: Setup
    recorded: Recorded
    records: list[RecordedMessage]
    references: dict[tuple[Any, ...], Replayed]  # by their messages: many kinds leave the same


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Clean:
    setup = cases.short(tmp_path_factory.mktemp("clean"))
    recorded = cases.fly(setup)
    return Clean(setup, recorded, cases.read(setup.folder / "recording.mcap"), {})


def strikes(kind: str) -> dict[str, Struck[Any]]:
    imu, tracker, arm = (action for action, _ in KINDS[kind])
    return {
        IMU: Struck(imu, 0.03, 1, rest=3),
        TRACKER: Struck(tracker, 0.3, 2, rest=1),
        ARM: Struck(arm, 0.01, 3, only=is_tpdo1, rest=3800 if kind in RARE else 30),
    }


def with_and_without(
    clean: Clean, taps: Mapping[str, Any], folder: Path
) -> tuple[Replayed, Replayed]:
    """Replay the disturbed recording, and the one without what no device sent."""
    disturbed = cases.tapped(clean.records, taps)
    reference = cases.lacking(disturbed, clean.records)
    known, config = clean.references, clean.setup.config
    key = tuple((record.t_ns, record.topic, record.data) for record in reference)
    if key not in known:
        known[key] = cases.run(cases.write(folder / "reference.mcap", reference), config)
    return cases.run(cases.write(folder / "disturbed.mcap", disturbed), config), known[key]


def assert_same(a: Replayed, b: Replayed) -> None:
    found = cases.differences(a, b)
    assert max(found.values()) <= SAME, found


@pytest.mark.parametrize("kind", KINDS)
def test_malformed_input_is_rejected_counted_and_leaves_no_trace(
    clean: Clean, tmp_path: Path, kind: str
) -> None:
    struck = strikes(kind)
    taps: dict[str, Any] = dict(struck)
    if kind in GROUPED:
        taps[IMU] = chain(struck[IMU], Regrouped(3_300_000))
    disturbed, reference = with_and_without(clean, taps, tmp_path)
    assert_same(disturbed, reference)
    for topic, (_, reasons) in zip((IMU, TRACKER, ARM), KINDS[kind], strict=True):
        counters = disturbed.samples[LINKS[topic]]
        rejected = {r for r in REJECTS if counters[f"reject_{r}"]}
        assert struck[topic].count >= 5
        assert rejected <= reasons
        # a last item may still be pending, or not have been handed over
        assert struck[topic].count - counters["rejected"] in (0, 1), topic
        assert conserved(counters)
        assert counters["late"] == 0
        assert reference.samples[LINKS[topic]]["rejected"] == 0
        assert reference.samples[LINKS[topic]]["accepted"] == counters["accepted"]


def test_every_flipped_bit_of_a_datagram_in_mid_stream_is_rejected(
    clean: Clean, tmp_path: Path
) -> None:
    struck = {
        IMU: Struck(FlipEveryBit(), 1.0, 1, rest=7),
        TRACKER: Struck(FlipEveryBit(), 1.0, 1, rest=1),
    }
    disturbed, reference = with_and_without(clean, struck, tmp_path)
    assert_same(disturbed, reference)
    assert struck[IMU].count >= 8 * 42
    for topic, tap in struck.items():
        sent = sum(record.topic == topic for record in clean.records)
        counters = disturbed.samples[LINKS[topic]]
        assert sent - counters["accepted"] == tap.count
        assert conserved(counters)


def test_every_flipped_bit_of_a_solution_in_mid_stream_is_rejected(clean: Clean) -> None:
    assert clean.setup.config.star_tracker is not None
    source = StarTrackerSource(clean.setup.config.star_tracker)
    flip = FlipEveryBit()
    rng = np.random.default_rng(0)
    frames = [
        sagitta.frame(
            sagitta.solution_payload(
                sagitta.Solution(
                    q_wxyz=(0.5, 0.5, -0.5, 0.5), unix_us=10**15 + 200_000 * k, ticks=k
                )
            )
        )
        for k in range(1500)
    ]
    bits = 8 * max(map(len, frames))
    kept = []
    for k, frame in enumerate(frames):
        item = (10**9 + 200_000_000 * k, frame)
        if k % 2 and flip.bit < bits:
            (item,) = flip(item, rng)
        received_ns = source.feed([ByteChunk(*item)]).t_receive_ns
        kept += ((received_ns - 10**9) // 200_000_000).tolist()
    assert flip.bit == bits
    flipped = set(range(1, 2 * bits, 2))
    # the last frame may be what a flipped delimiter holds back; none of these is the last
    assert kept == [k for k in range(1500) if k not in flipped]
    assert conserved(source.counters)


def test_bytes_are_conserved_and_accepted_frames_encode_to_themselves(clean: Clean) -> None:
    struck = strikes("bits flipped, encoder at fault")
    records = cases.tapped(clean.records, struck)
    stim, star = Stim300Codec(10, crlf=False), SagittaCodec()
    done = {IMU: 0, TRACKER: 0, ARM: 0}
    for can in frame_list(frames_of([record for record in records if record.topic == ARM])):
        if is_tpdo1((can.t_ns, can.can_id, can.data, can.is_fd)):
            assert encoded_tpdo1(can.data) == can.data
            done[ARM] += 1
    for record in records:
        chunk = ByteChunk(record.t_ns, record.data)
        if record.topic == IMU:
            for frame in stim.framer.feed(chunk):
                assert encoded_stim(frame.data) == frame.data
                done[IMU] += 1
        elif record.topic == TRACKER:
            for frame in star.framer.feed(chunk):
                if len(frame.data) > 80:  # shorter: the answer to the subscription
                    assert encoded_sagitta(frame.data) == frame.data
                    done[TRACKER] += 1
    sent = {topic: sum(record.topic == topic for record in clean.records) for topic in done}
    assert done[IMU] == sent[IMU] - struck[IMU].count
    # one of those sent is the answer
    assert done[TRACKER] in (sent[TRACKER] - struck[TRACKER].count - k for k in (0, 1))
    assert done[ARM] > 30_000


def encoded_stim(data: bytes) -> bytes:
    d = flight_stim300.decode_datagram(data, 10)
    assert isinstance(d, StimDatagram)
    zeros = np.zeros((1, 3))
    measured = stim300.Measurements(
        w_NS_S_rad_s=np.array([d.gyro_rad_s]),
        f_NS_S_m_s2=np.array([d.acc_m_s2]),
        inclination_g=zeros,
        gyro_temperature_degc=np.array([d.gyro_temperature_c]),
        acc_temperature_degc=np.array([d.acc_temperature_c]),
        incl_temperature_degc=zeros,
        counter=np.array([d.counter]),
        latency_us=np.array([d.latency_us]),
        status=np.array([d.gyro_status]),
    )
    (again,) = stim300.encode(d.identifier, measured, 10)
    return again


def encoded_sagitta(data: bytes) -> bytes:
    payload = flight_sagitta.decode_payload(data)
    assert isinstance(payload, bytes)
    telemetry = flight_sagitta.decode_telemetry(payload)
    assert isinstance(telemetry, flight_sagitta.Telemetry)
    s = flight_sagitta.decode_solution(telemetry)
    assert isinstance(s, flight_sagitta.Solution)
    again = sagitta.Solution(
        q_wxyz=s.q_wxyz,
        unix_us=s.unix_us,
        ticks=s.ticks,
        confidence=s.confidence,
        matched_count=s.stars_matched,
        mode=s.mode,
        valid=s.valid,
        stable_count=s.stable_count,
        strategy=s.strategy,
    )
    return sagitta.frame(sagitta.solution_payload(again))


def encoded_tpdo1(data: bytes) -> bytes:
    position, torque, status, counter = READ_JOINT(np.frombuffer(data, np.uint8)[None])
    measured = reading(float(position[0]), torque_nm=float(torque[0]))
    return canopen.encode_tpdo1(measured, int(status[0]), int(counter[0]))


def test_a_possible_but_implausible_reading_is_gated_like_a_missing_one(
    clean: Clean, tmp_path: Path
) -> None:
    """Forces of 9 g pass every check of the datagram; only the window shows they cannot be."""
    config = clean.setup.config
    results = []
    for name, edit in (
        ("absurd", stim_fields(acc=(0, 9 << 19, 5))),
        ("flagged", stim_fields(acc_status=0x10)),
    ):
        tap = Struck(rewrite(edit), 0.01, 1, rest=3)
        records = cases.tapped(clean.records, {IMU: tap})
        results.append(cases.run(cases.write(tmp_path / f"{name}.mcap", records), config))
    absurd, flagged = results
    assert_same(absurd, flagged)
    assert tap.count > 20
    # readings behind the last closed window are not judged
    assert 0 <= tap.count - absurd.windows["outliers"] < 5
    assert flagged.windows["outliers"] == 0


@pytest.mark.parametrize("seed", range(2))
def test_other_flips_on_the_same_noise_leave_it_consistent(
    clean: Clean, tmp_path: Path, seed: int
) -> None:
    tap = Struck(flip_payload, 1e-3, 100 + seed, only=is_tpdo1)
    records = cases.tapped(clean.records, {ARM: tap})
    estimate = cases.run(cases.write(tmp_path / "flips.mcap", records), clean.setup.config).estimate
    assert tap.count > 10
    assert estimate.valid
    error = cases.normalised_error(clean.setup, estimate.mean, estimate.covariance)
    assert error < CHI2_10_999
