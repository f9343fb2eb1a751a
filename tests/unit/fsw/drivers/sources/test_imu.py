import dataclasses
import math
import struct
from collections.abc import Sequence
from copy import deepcopy
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsw.drivers.codecs.mip import MipCodec
from fsw.drivers.sources.imu import ImuSource
from fsw.drivers.wire import ByteChunk
from fsw.messages.findings import Fault
from tests.support import serial_line as lines
from tests.support.driver_configs import imu_config
from tests.support.encoders import GRAVITY, Stim, mip
from tests.support.samples import Row, rows
from tests.support.serial_line import Line

BOUND_NS = 100_000  # the requirement: 0.1 ms rms after 5 s
DATAGRAM = Stim(0xA5, counter=100, latency_us=900)
MS = 1_000_000


class RowSource(ImuSource):
    """An inertial unit whose samples come row by row."""

    def feed(self, chunks: Sequence[ByteChunk]) -> list[Row]:  # type: ignore[override]
        return rows(super().feed(chunks))


def source(**changes: object) -> RowSource:
    return RowSource(imu_config(**changes))


def conserved(imu: ImuSource) -> bool:
    c = imu.counters
    total = c["accepted_bytes"] + c["rejected_bytes"] + c["skipped_bytes"] + c["pending_bytes"]
    return total == c["received_bytes"] and c["accepted"] + c["rejected"] == c["received"]


def stim(k: int, **changes: object) -> bytes:
    given = {"counter": 100 + 4 * k, "values": {"g": (k, 0, 0)}} | changes
    return dataclasses.replace(DATAGRAM, **given).encode()  # type: ignore[arg-type]


def number(sample: Row) -> int:
    """Return the number of a sample; its rate tells it."""
    return round(math.degrees(sample.w_NS_S_rad_s[0]) * 2**14)


def paced(imu: RowSource, ks: range, start_ns: int = 10**12) -> list[Row]:
    return imu.feed([ByteChunk(start_ns + 2 * MS * k, stim(k)) for k in ks])


def test_known_biases_are_taken_off_every_sample() -> None:
    gyro, acc = (1e-3, -2e-3, 3e-3), (0.01, 0.02, -0.03)
    chunks = [ByteChunk(10**12 + 2 * MS * k, stim(k)) for k in range(60)]
    plain = ImuSource(imu_config()).feed(chunks)
    less = ImuSource(imu_config(gyro_bias_S_rad_s=gyro, acc_bias_S_m_s2=acc)).feed(chunks)
    assert len(plain) == 60
    np.testing.assert_array_equal(less.w_NS_S_rad_s, plain.w_NS_S_rad_s - gyro)
    np.testing.assert_array_equal(less.f_NS_S_m_s2, plain.f_NS_S_m_s2 - acc)
    np.testing.assert_array_equal(less.t_gyro_ns, plain.t_gyro_ns)


def test_the_gyros_matrix_is_applied_to_every_sample() -> None:
    matrix = ((1.01, 0.02, 0.0), (0.0, 1.0, 0.0), (-0.03, 0.0, 0.98))
    chunks = [ByteChunk(10**12 + 2 * MS * k, stim(k)) for k in range(60)]
    plain = ImuSource(imu_config()).feed(chunks)
    changed = ImuSource(imu_config(gyro_matrix=matrix)).feed(chunks)
    expected = [np.array(matrix) @ w for w in plain.w_NS_S_rad_s]
    np.testing.assert_allclose(changed.w_NS_S_rad_s, expected, rtol=1e-14)
    np.testing.assert_array_equal(changed.f_NS_S_m_s2, plain.f_NS_S_m_s2)


@cache
def twelve_seconds(ppm: float) -> tuple[Line, np.random.Generator]:
    """Return a line, and the generator that has made it."""
    rng = np.random.default_rng(5)
    return Line(12.0, ppm, rng), rng


@pytest.mark.parametrize("ppm", [-50.0, 0.0, 50.0])
@pytest.mark.parametrize(
    "polls",
    [
        lines.each_datagram(100e3),
        lines.each_datagram(500e3),
        lines.random_splits(0.05, 100e3),
        lines.random_splits(1.0, 20e3),
        lines.grid(1e6, 600e3),
        lines.grid(4e6, 1.5e6),
        lines.grid(10e6, 2e6),
        lines.poisson(1e6),
        lines.poisson(20e6),
    ],
    ids=["datagram", "late", "splits", "bytes", "1ms", "4ms", "10ms", "poisson1", "poisson20"],
)
def test_time_of_validity_with_any_chunking(ppm: float, polls: lines.Polls) -> None:
    line, made_by = twelve_seconds(ppm)
    rng = deepcopy(made_by)
    imu = source()
    samples = imu.feed(line.chunks(polls(line.byte_ns, line.size, rng)))
    k = np.array([number(s) for s in samples])
    for delay_ns, times in ((2.2e6, [s.t_gyro_ns for s in samples]),
                            (6.3e6, [s.t_acc_ns for s in samples])):  # fmt: skip
        error = np.array(times, dtype=float) + delay_ns - line.valid_ns[k]
        assert np.sqrt(np.mean(error[k >= 5 * lines.RATE_HZ] ** 2)) <= BOUND_NS
    assert imu.counters["rejected"] == imu.counters["lost"] == 0
    assert conserved(imu)
    assert abs(imu.clock_rate_error_ppm - ppm) < 20.0


def test_the_first_sample_comes_at_once_by_arrival_alone() -> None:
    (sample,) = source().feed([ByteChunk(10**12, stim(0))])
    sent_ns = 10**12 - 42 * 10e9 / 921600 - 900e3
    assert sample.t_gyro_ns == round(sent_ns - 2.2e6)
    assert sample.t_acc_ns == round(sent_ns - 6.3e6)
    assert sample.t_receive_ns == 10**12


@settings(max_examples=30)
@given(st.data())
def test_junk_between_datagrams_moves_no_bit_of_any_sample(data: st.DataObject) -> None:
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    line = Line(0.4, 50.0, rng)
    clean, dirty, end = [], [], 0
    for chunk in line.chunks(lines.grid(1.7e6, 400e3)(line.byte_ns, line.size, rng)):
        clean.append(chunk)
        out = b""
        for byte in chunk.data:
            if end % line.size == 0 and end > 0 and rng.random() < 0.2:
                bad = bytearray(line.datagrams[0][: int(rng.integers(1, 43))])
                bad[int(rng.integers(0, len(bad)))] ^= 1 << int(rng.integers(0, 8))
                out += (bytes(bad), rng.bytes(int(rng.integers(1, 90))))[int(rng.random() < 0.5)]
            out += bytes([byte])
            end += 1
        dirty.append(ByteChunk(chunk.t_ns, out))
    first, second = source(), source()
    assert first.feed(clean) == second.feed(dirty)
    assert second.counters["rejected"] > 0
    assert conserved(second)


@pytest.mark.parametrize(
    "changes",
    [
        {"values": {"g": (2**23 - 1, 0, 0)}},  # 512 deg/s
        {"values": {"a": (0, 0, -(2**23))}},  # 16 g of a 10 g unit
        {"latency_us": 65535},
    ],
)
def test_absurd_values_with_a_valid_crc_change_nothing_but_a_counter(
    changes: dict[str, object],
) -> None:
    clean, dirty = source(), source()
    reference = paced(clean, range(40))
    samples = []
    for k in range(40):
        good = stim(k)
        bad = stim(k, **changes) if k % 7 == 3 else b""
        samples += dirty.feed([ByteChunk(10**12 + 2 * MS * k, bad + good)])
    assert samples == reference
    assert dirty.counters["reject_range"] == 6
    assert dirty.counters["lost"] == 0
    assert conserved(dirty)


def test_duplicates_and_wrong_counters_are_rejected() -> None:
    clean, dirty = source(), source()
    reference = paced(clean, range(300))
    samples = []
    for k in range(300):
        extra = b""
        if k % 50 == 20:
            extra = stim(k - 1) + stim(k + 20) + stim(k - 7)
        samples += dirty.feed([ByteChunk(10**12 + 2 * MS * k, extra + stim(k))])
    assert samples == reference
    assert dirty.counters["reject_sequence"] == 18
    assert dirty.counters["lost"] == 0


@pytest.mark.parametrize("extra_us", [300, 1000, 9000])
def test_a_latency_that_would_put_the_sample_ahead_of_the_clock_is_untrue(extra_us: int) -> None:
    lacking, lying = source(), source()
    told = DATAGRAM.latency_us + extra_us
    paced(lacking, range(300))
    paced(lying, range(300))
    at = 10**12 + 2 * MS * 300
    assert lying.feed([ByteChunk(at, stim(300, latency_us=told))]) == []
    assert lying.counters["reject_range"] == lying.counters["rejected"] == 1
    assert paced(lying, range(301, 400)) == paced(lacking, range(301, 400))


@pytest.mark.parametrize("extra_us", [300, 1000, 9000])
def test_a_datagram_that_did_wait_longer_keeps_its_time(extra_us: int) -> None:
    prompt, waiting = source(), source()
    told = DATAGRAM.latency_us + extra_us
    before = paced(prompt, range(301))[-1]
    paced(waiting, range(300))
    at = 10**12 + 2 * MS * 300 + 1000 * extra_us
    (after,) = waiting.feed([ByteChunk(at, stim(300, latency_us=told))])
    assert abs(after.t_gyro_ns - before.t_gyro_ns) <= 1


@pytest.mark.parametrize("gap", [1, 5, 63, 64, 65, 500, 3000])
def test_a_silent_unit_comes_back_in_step(gap: int) -> None:
    imu, whole = source(), source()
    before = paced(imu, range(600))
    after = paced(imu, range(600 + gap, 900 + gap))
    reference = paced(whole, range(900 + gap))
    assert imu.counters["lost"] == gap
    assert imu.counters["rejected"] == 0
    assert [number(s) for s in before + after] == [
        number(s) for s in reference[:600] + reference[600 + gap :]
    ]
    late = np.array([s.t_gyro_ns for s in after]) - [s.t_gyro_ns for s in reference[600 + gap :]]
    assert np.abs(late).max() < 1000


def test_a_stalled_reader_is_no_loss() -> None:
    imu = source()
    paced(imu, range(500))
    backlog = b"".join(stim(k) for k in range(500, 590))
    samples = imu.feed([ByteChunk(10**12 + 2 * MS * 589, backlog)])
    samples += paced(imu, range(590, 700))
    assert [number(s) for s in samples] == list(range(500, 700))
    assert imu.counters["lost"] == imu.counters["rejected"] == 0
    steps = np.diff([s.t_gyro_ns for s in samples])
    assert np.abs(steps - 2 * MS).max() < 1000


@pytest.mark.parametrize("offset", [1, 2, 17, 130])
def test_a_restarted_unit_is_believed_after_a_tenth_of_a_second(offset: int) -> None:
    imu = source()
    paced(imu, range(1000))
    start_ns = 10**12 + 2_500 * MS + 700_000
    samples = []
    for k in range(3000):
        data = stim(k, counter=offset + 4 * k)
        samples += imu.feed([ByteChunk(start_ns + 2 * MS * k, data)])
    assert len(samples) >= 3000 - 60
    sent_ns = start_ns - 42 * 10e9 / 921600 - 900e3 - 2.2e6
    last = samples[-1]
    assert abs(last.t_gyro_ns - (sent_ns + 2 * MS * 2999)) < BOUND_NS
    assert (np.diff([number(s) for s in samples]) > 0).all()


@given(st.lists(st.binary(max_size=120), max_size=8), st.integers(0, 2))
def test_arbitrary_bytes_never_raise_and_are_conserved(parts: list[bytes], k: int) -> None:
    imu = source(crlf=bool(k % 2))
    for at, part in enumerate([*parts, stim(k), *parts]):
        imu.feed([ByteChunk(10**12 + at, part)])
        assert conserved(imu)


def test_values_are_in_si_units_and_clusters_apart() -> None:
    values = {"g": (16384, 0, -16384), "a": (2**19, 0, -(2**19))}
    imu = source()
    (sample,) = imu.feed([ByteChunk(0, stim(0, values=values, status={"a": 0x10}))])
    assert sample.w_NS_S_rad_s == pytest.approx((math.radians(1), 0.0, -math.radians(1)))
    assert sample.f_NS_S_m_s2 is None
    assert [finding.fault for finding in imu.findings()] == [Fault.ACC_OVERLOAD]
    (sample,) = source().feed([ByteChunk(0, stim(0, values=values))])
    assert sample.f_NS_S_m_s2 == pytest.approx((GRAVITY, 0.0, -GRAVITY))


def test_the_layer_carries_another_protocol() -> None:
    imu = RowSource(imu_config(), MipCodec())
    chunks = []
    for k in range(200):
        if k == 100:
            continue
        packet = mip([(0x04, struct.pack(">3f", 0, 0, 1)), (0x05, struct.pack(">3f", 0.1, 0, 0)),
                      (0xD5, struct.pack(">Q", 55 + 2 * MS * k))])  # fmt: skip
        chunks.append(ByteChunk(10**12 + 2 * MS * k, packet))
    samples = imu.feed(chunks)
    assert len(samples) == 199
    assert imu.counters["lost"] == 1
    assert samples[-1].f_NS_S_m_s2 == (0.0, 0.0, GRAVITY)
    size = len(chunks[0].data)
    assert samples[-1].t_gyro_ns == pytest.approx(
        chunks[-1].t_ns - size * 10e9 / 921600 - 2.2e6, abs=2
    )
