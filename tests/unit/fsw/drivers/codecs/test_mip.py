import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.drivers.codecs.imu_datagram import ImuDatagram
from fsw.drivers.codecs.mip import MipCodec
from fsw.drivers.wire import ByteChunk, Reject
from tests.support.encoders import GRAVITY, mip

finite = st.floats(-100, 100, width=32)
vectors = st.tuples(finite, finite, finite)


def packet(acc: tuple[float, ...], gyro: tuple[float, ...], time_ns: int) -> bytes:
    fields = [
        (0x04, struct.pack(">3f", *acc)),
        (0x05, struct.pack(">3f", *gyro)),
        (0xD5, struct.pack(">Q", time_ns)),
        (0xD6, struct.pack(">Q", 2_000_000)),
    ]
    return mip(fields)


def decode(data: bytes) -> list[ImuDatagram | Reject | None]:
    codec = MipCodec()
    return [codec.decode(f) for f in codec.framer.feed(ByteChunk(0, data))]


@given(vectors, vectors, st.integers(0, 2**64 - 1))
def test_values_come_through(acc: tuple[float, ...], gyro: tuple[float, ...], time_ns: int) -> None:
    (d,) = decode(packet(acc, gyro, time_ns))
    assert isinstance(d, ImuDatagram)
    assert d.f_NS_S_m_s2 == tuple(x * GRAVITY for x in acc)
    assert d.w_NS_S_rad_s == gyro
    assert d.counter == time_ns


def test_every_single_bit_flip_is_rejected() -> None:
    good = packet((0.1, 0.2, 1.0), (0.01, -0.02, 0.03), 10**15)
    for bit in range(8 * len(good)):
        bad = bytearray(good)
        bad[bit // 8] ^= 1 << bit % 8
        codec = MipCodec()
        data = good + bytes(bad) + 6 * good
        found = [f.data for f in codec.framer.feed(ByteChunk(0, data))]
        assert found == [good] * 7, bit


def test_packets_without_time_or_of_other_sets_are_no_samples() -> None:
    assert decode(mip([(0x05, bytes(12))])) == [Reject.STALE]
    assert decode(mip([(0xF1, b"\x01\x00")], 0x01)) == [None]
    assert decode(mip([(0x05, struct.pack(">3f", float("nan"), 0, 0))])) == [Reject.RANGE]


VECTOR, TIME = bytes(12), (0xD5, bytes(8))


@pytest.mark.parametrize(
    ("packets", "words"),
    [
        ([], ""),
        ([mip([(0x04, VECTOR), (0x05, VECTOR), TIME])], ""),
        ([mip([(0x04, VECTOR), TIME]), mip([(0x05, VECTOR), TIME])], ""),
        (
            [mip([(0x04, VECTOR), (0x05, VECTOR), (0x12, VECTOR)])],
            "packets have no reference time (field 0xD5), found 0x04 0x05 0x12",
        ),
        (
            [mip([(0x07, VECTOR), (0x08, VECTOR), TIME])],
            "no rate and acceleration (fields 0x05, 0x04), found 0x07 0x08",
        ),
        ([mip([(0x05, VECTOR), TIME])], "no acceleration (field 0x04), found 0x05"),
        ([mip([(0x04, VECTOR), TIME])], "no rate (field 0x05), found 0x04"),
        ([mip([TIME])], "no rate and acceleration (fields 0x05, 0x04), found nothing"),
        ([mip([TIME, (0x10, bytes(6))], 0x82)], "no sensor data (set 0x80), found 0x82"),
    ],
)
def test_a_stream_without_a_needed_field_says_which(packets: list[bytes], words: str) -> None:
    codec = MipCodec()
    for data in packets:
        for frame in codec.framer.feed(ByteChunk(0, data)):
            codec.decode(frame)
    assert codec.lacks() == words


def test_a_packet_without_rate_and_acceleration_is_no_sample() -> None:
    assert decode(mip([TIME, (0x06, VECTOR)])) == [None]


@given(st.binary(max_size=400))
def test_arbitrary_bytes_never_raise_and_are_conserved(data: bytes) -> None:
    codec = MipCodec()
    found = codec.framer.feed(ByteChunk(0, data))
    for frame in found:
        codec.decode(frame)
    framer = codec.framer
    taken = sum(len(f.data) for f in found)
    assert taken + framer.skipped_bytes + framer.pending_bytes == len(data)
    assert framer.pending_bytes <= 134
    decode(mip([(k, data[k : k + 9]) for k in range(min(9, len(data)))]))
