"""A feed's datagrams become samples with their times; every other datagram is counted."""

import json
import random
import tracemalloc

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fsw.drivers.wire import ByteChunk
from fsw.messages.findings import Fault
from hil.devices.feed import as_json, packed
from tests.support.feed_cases import (
    KEY,
    MS,
    RATE_HZ,
    SOURCE,
    START_NS,
    Sender,
    counts,
    joint_times_ns,
    on_feed,
    source_of,
)
from tests.support.samples import plain


def faults(source):
    return [finding.fault for finding in source.findings()]


def test_values_are_calibrated_and_valid_at_the_senders_time(arm):
    on_feed(arm).data["joints"][0] |= {"sign": -1, "zero_offset_rad": 0.5, "torque_gain": 2.0}
    arm.data["buses"][0]["latch_offset_s"] = 1e-3
    source, sender = source_of(arm), Sender()
    (samples,) = source.feed(sender.stream(3))
    assert samples.joint.tolist() == [0, 1, 2] * 3
    assert np.allclose(samples.position_rad[:3], [-0.6, -0.1, 0.2])
    assert np.allclose(samples.torque_nm[:3], [-2.0, 2.0, 3.0])
    assert (np.diff(joint_times_ns([samples])) == 4 * MS).all()
    assert samples.t_ns[0] == START_NS + MS
    assert samples.t_receive_ns[0] == START_NS + 500_000
    assert counts(source) == {"received": 9, "accepted": 9}
    assert faults(source) == []


def test_json_gives_the_same_samples_as_packed_datagrams(arm):
    on_feed(arm)
    chunks, texts = Sender().stream(5), []
    for k, chunk in enumerate(chunks):
        t_ns = START_NS + 4 * k * MS
        values = np.frombuffer(chunk.data[40:]).tolist()
        texts.append(ByteChunk(chunk.t_ns, as_json(SOURCE, k, (t_ns, t_ns + 200_000), values)))
    one, other = source_of(arm), source_of(arm)
    assert [plain(s) for s in one.feed(chunks)] == [plain(s) for s in other.feed(texts)]


def test_lost_doubled_and_overtaken_datagrams_are_counted_and_reported(arm):
    source, chunks = source_of(on_feed(arm)), Sender().stream(20)
    given = [*chunks[:5], chunks[4], *chunks[7:10], chunks[5], *chunks[10:]]
    at_ns = max(chunk.t_ns for chunk in given)
    source.feed([ByteChunk(max(c.t_ns, at_ns), c.data) for c in given])
    assert counts(source) == {
        "received": 56, "accepted": 54, "rejected": 2, "lost": 6, "reject_sequence": 2,
    }  # fmt: skip
    found = faults(source)
    assert [f for f in found if f is not Fault.JOINT_LATE] == [
        Fault.JOINT_DUPLICATE,
        Fault.JOINT_LOST,
        Fault.JOINT_ORDER,
    ]
    assert found.count(Fault.JOINT_LATE) > 0  # all wait for the last


def test_foreign_and_damaged_datagrams_are_counted_and_change_nothing(arm):
    alone, sender = source_of(on_feed(arm)), Sender()
    good = sender.stream(50)
    source = source_of(arm)
    rng = random.Random(5)
    foreign = Sender()
    given = []
    for chunk in good:
        hostile = [
            rng.randbytes(rng.randrange(1500)),
            b"FSW1" + rng.randbytes(rng.randrange(100)),
            foreign.bytes_at(chunk.t_ns - 500_000, source=8),
            foreign.bytes_at(chunk.t_ns - 500_000, kind="imu"),
            foreign.bytes_at(chunk.t_ns - 500_000, values=[0.0] * 7),
            b"{" * 1000,
            b"x" * 2048,
            b"",
            good[0].data,
        ]
        given += [ByteChunk(chunk.t_ns, data) for data in hostile] + [chunk]
    found = [plain(samples) for samples in source.feed(given)]
    assert found == [plain(samples) for samples in alone.feed(good)]
    counted = counts(source)
    assert counted["accepted"] == 150
    assert counted["rejected"] == 450
    assert counted["reject_node"] == 100
    assert counted["reject_sequence"] == 50
    assert {Fault.NODE_UNKNOWN, Fault.JOINT_LENGTH} < set(faults(source))


def test_a_flood_takes_bounded_memory_and_raises_nothing(arm):
    source, rng = source_of(on_feed(arm, everything=True)), random.Random(1)
    good = Sender().stream(1)
    tracemalloc.start()
    for k in range(20):
        heads = [good[0].data[: rng.randrange(60)] + rng.randbytes(50) for _ in range(1000)]
        source.feed([ByteChunk(START_NS + k * MS, data) for data in heads])
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 4 << 20
    assert sum(source.counters[name]["received"] for name in source.counters) == 20_000
    assert len(source.findings()) <= 3 * 1024 + 1024


def test_a_restarted_sender_is_believed_after_a_tenth_of_a_second(arm):
    source = source_of(on_feed(arm))
    source.feed(Sender().stream(50))
    later = Sender()
    later.sequence = 1 << 31
    later_chunks = later.stream(100, first=60)
    (samples,) = source.feed(later_chunks)
    assert samples.t_receive_ns[0] - later_chunks[0].t_ns == 100 * MS
    assert counts(source)["reject_sequence"] == 25
    assert faults(source).count(Fault.NODE_RESTARTED) == 1


def test_a_second_sender_of_the_same_number_never_takes_the_place_of_the_first(arm):
    source, first, second = source_of(on_feed(arm)), Sender(), Sender()
    second.sequence = 1000
    one = first.stream(200)
    other = [ByteChunk(c.t_ns + 1, c.data) for c in second.stream(200, values=[9.0] * 6)]
    both = [chunk for pair in zip(one, other, strict=True) for chunk in pair]
    (samples,) = source.feed(both)
    assert np.abs(samples.position_rad).max() < 1.0
    assert counts(source)["accepted"] == 600


@pytest.mark.parametrize(("clock", "drift"), [("device", 8e-5), ("unix", -3e-5), ("tai", 0.0)])
def test_another_clock_is_fitted_under_the_arrivals(arm, clock, drift):
    source = source_of(on_feed(arm, clock=clock))
    sender = Sender(clock=clock, offset_ns=1_700_000_000 * 10**9, drift=drift)
    rng = np.random.default_rng(3)
    count = round(20 * RATE_HZ)
    times_ns = START_NS + np.arange(count) * 4 * MS
    delays_ns = 200_000 + 100_000 + rng.exponential(1e6, count).astype(int)
    arrived_ns = np.maximum.accumulate(times_ns + delays_ns)
    given = [
        ByteChunk(int(t), sender.bytes_at(int(valid)))
        for t, valid in zip(arrived_ns, times_ns, strict=True)
    ]
    (samples,) = source.feed(given)
    error_ns = joint_times_ns([samples]) - times_ns
    settled = error_ns[count // 4 :]
    # the least delay, 0.1 ms, cannot be told from the clock's offset
    assert np.abs(settled - 100_000).max() < 50_000
    assert "rejected" not in counts(source)


def test_times_that_contradict_each_other_are_refused(arm):
    source, sender = source_of(on_feed(arm)), Sender()
    source.feed(sender.stream(5))
    wrong = [
        (START_NS + 30 * MS, START_NS + 20 * MS),  # valid after it was sent
        (START_NS + 30 * MS, START_NS + 10**12),  # sent after it arrived
        (START_NS - 2 * 10**9, START_NS + 30 * MS),  # older than a second
    ]
    given = [
        ByteChunk(START_NS + 40 * MS, sender.bytes_at(START_NS, times_ns=times)) for times in wrong
    ]
    assert source.feed(given) == []
    assert counts(source)["reject_stale"] == 3
    other = Sender(clock="device")
    assert source.feed([ByteChunk(START_NS + 40 * MS, other.bytes_at(START_NS))]) == []
    (finding,) = [f for f in source.findings() if "clock" in f.text]
    assert "device, not monotonic" in finding.text


def test_with_a_key_nothing_older_than_the_newest_is_ever_accepted(arm):
    source = source_of(on_feed(arm, clock="unix", key_file="feed.key"))
    sender = Sender(clock="unix", offset_ns=1_700_000_000 * 10**9)
    sender.key = KEY
    old = sender.stream(100)
    source.feed(old)
    replayed = [ByteChunk(c.t_ns + 10**9, c.data) for c in old]
    assert source.feed(replayed) == []
    assert counts(source)["reject_sequence"] == 100
    sender.sequence = 5  # restarted: a later time is believed at once
    (samples,) = source.feed(sender.stream(10, first=400))
    assert len(samples) == 30
    sender.key = bytes(32)
    assert source.feed(sender.stream(10, first=500)) == []
    assert counts(source)["reject_crc"] == 10


def test_a_masked_torque_leaves_the_position_and_a_masked_position_nothing(arm):
    source, sender = source_of(on_feed(arm)), Sender()
    (samples,) = source.feed(sender.stream(4, mask=0b101_110))
    assert samples.joint.tolist() == [1, 2] * 4
    assert np.isnan(samples.torque_nm[::2]).all()
    assert np.isfinite(samples.torque_nm[1::2]).all()
    assert counts(source) == {
        "received": 12, "accepted": 8, "rejected": 4, "reject_status": 4,
    }  # fmt: skip
    assert set(faults(source)) == {Fault.ENCODER_FAULT, Fault.TORQUE_FAULT}


def test_jumps_and_torques_beyond_the_limit_are_refused_as_on_a_bus(arm):
    source, sender = source_of(on_feed(arm)), Sender()
    source.feed(sender.stream(60))
    jump = sender.stream(1, first=60, values=[2.0, -0.112, 0.224, 1.0, 99.0, 3.0])
    (samples,) = source.feed(jump)
    assert samples.joint.tolist() == [2]
    assert set(faults(source)) == {Fault.ENCODER_JUMP, Fault.TORQUE_RANGE}


def test_speeds_are_read_by_joints_without_position(arm):
    joint = on_feed(arm).data["joints"][1]
    del joint["position_noise_rad"]
    joint |= {"encoder": "speed", "speed_noise_rad_s": 1e-3}
    source, sender = source_of(arm), Sender()
    (samples,) = source.feed(sender.stream(1, values=[0.1, 9.0, 0.2, 1.0, 2.0, 3.0, 7.0, 0.3, 7.0]))
    assert np.allclose(samples.position_rad, [0.1, 0.3, 0.2])


def test_inertial_unit_and_star_tracker_come_by_the_same_feed(arm):
    source = source_of(on_feed(arm, everything=True))
    q = Rotation.from_euler("xyz", (0.3, -0.2, 0.5)).as_quat()
    rate, force = [0.01, 0.02, -0.03], [0.1, -0.2, 0.3]
    times_ns = START_NS, START_NS + 200_000
    at_ns = START_NS + 500_000
    given = [
        packed(SOURCE, 9, times_ns, [*rate, *force], kind="imu"),
        packed(SOURCE, 10, (START_NS + 1, at_ns - 1), [9.0, *rate[1:], *force], kind="imu"),
        packed(SOURCE, 11, (START_NS + 2, at_ns), [*rate, *force], kind="imu", mask=0b000_111),
        packed(SOURCE, 3, times_ns, q, kind="attitude"),
        packed(SOURCE, 4, (START_NS + 1, at_ns), [0.0] * 4, kind="attitude"),
    ]
    found = source.feed([ByteChunk(at_ns, data) for data in given])
    imu, attitude = found
    assert np.allclose(imu.w_NS_S_rad_s, [rate, rate])
    assert np.allclose(imu.f_NS_S_m_s2, [force, [np.nan] * 3], equal_nan=True)
    assert imu.t_gyro_ns[0] == START_NS - 2_200_000
    assert imu.t_acc_ns[0] == START_NS - 6_300_000
    assert attitude.t_ns.tolist() == [START_NS - 100 * MS]
    assert np.allclose(Rotation.from_quat(attitude.q_NB_xyzw[0]).inv().as_quat(), q)
    assert counts(source, "imu") == {
        "received": 3, "accepted": 2, "rejected": 1, "reject_range": 1,
    }  # fmt: skip
    assert counts(source, "star_tracker") == {
        "received": 2, "accepted": 1, "rejected": 1, "reject_range": 1,
    }  # fmt: skip


def test_neither_samples_nor_counters_depend_on_where_a_batch_ends(arm):
    on_feed(arm, clock="device")
    sender, rng = Sender(clock="device", offset_ns=0, drift=4e-5), random.Random(2)
    chunks = sender.stream(400)
    given = [c for c in chunks if rng.random() > 0.05]
    given += [given[k] for k in (30, 90)]
    given.sort(key=lambda chunk: chunk.t_ns)
    whole = source_of(arm)
    at_once = [row for samples in whole.feed(given) for row in plain(samples)]
    for size in (1, 7, 33):
        source, rows = source_of(arm), []
        for first in range(0, len(given), size):
            rows += [
                r for samples in source.feed(given[first : first + size]) for r in plain(samples)
            ]
        assert rows == at_once
        assert source.counters == whole.counters


def test_a_silent_sender_is_reported_and_a_late_datagram_too(arm):
    source, sender = source_of(on_feed(arm)), Sender()
    chunks = sender.stream(10)
    source.feed(chunks)
    source.watch(chunks[-1].t_ns + 50 * MS, up=True)
    assert faults(source) == []
    source.watch(chunks[-1].t_ns + 150 * MS, up=True)
    assert faults(source) == [Fault.BUS_SILENT]
    late = [ByteChunk(c.t_ns + 30 * MS, c.data) for c in sender.stream(1, first=11)]
    assert len(source.feed(late)[0]) == 3
    assert Fault.JOINT_LATE in faults(source)


def test_the_sequence_number_wraps(arm):
    source, sender = source_of(on_feed(arm)), Sender()
    sender.sequence = (1 << 32) - 3
    source.feed(sender.stream(6))
    assert counts(source) == {"received": 18, "accepted": 18}


def test_json_with_every_key_of_the_document_is_enough(arm):
    text = {
        "source": 7, "sequence": 0, "kind": "joints", "clock": "monotonic",
        "t_valid_ns": START_NS, "t_sent_ns": START_NS,
        "values": [0.1, 0.2, 0.3, 1.0, None, 3.0],
    }  # fmt: skip
    source = source_of(on_feed(arm))
    (samples,) = source.feed([ByteChunk(START_NS + MS, json.dumps(text).encode())])
    assert np.allclose(samples.torque_nm, [1.0, np.nan, 3.0], equal_nan=True)
