import struct

import pytest
import xxhash

from hil.devices.sagitta import (
    SOLUTION_BYTES,
    RequestReader,
    Solution,
    answer,
    frame,
    solution_payload,
    subscription_of,
    unframe,
)

SUBSCRIBE = bytes([0x21, 0x00, 0x12, 0x18, 0x1B]) + bytes(14)


@pytest.mark.parametrize(
    ("payload", "wire"),
    [
        (bytes.fromhex("21030101"), "c0210301019c349a61c0"),
        (bytes.fromhex("210218"), "c0210218ac15e176c0"),
        (SUBSCRIBE, "c0210012181b" + "00" * 14 + "c6b9fe6cc0"),
    ],
)
def test_frames_are_the_vectors_of_the_icd(payload, wire):
    assert frame(payload).hex() == wire


def test_solution_has_the_icd_layout():
    solution = Solution(
        q_wxyz=(0.5, -0.5, 0.25, 0.75), unix_us=1_800_000_000_123_456, ticks=77, stable_count=9
    )
    payload = solution_payload(solution)
    assert len(payload) == 83
    assert len(payload) + 4 + 2 == SOLUTION_BYTES
    assert struct.unpack_from("<4BIQ", payload) == (0x21, 0x84, 24, 0, 77, 1_800_000_000_123_456)
    assert struct.unpack_from("<4f", payload, 16) == (0.5, -0.5, 0.25, 0.75)
    assert struct.unpack_from("<4f", payload, 36) == (0.5, -0.5, 0.25, 0.75)
    assert payload[52:55] == bytes([0, 25, 20])
    assert payload[77] == 1
    assert struct.unpack_from("<I", payload, 78) == (9,)


def test_escapes_come_back_and_delimiters_stay_outside():
    payload = bytes(range(256)) + b"\xdb\xdc\xc0\xdb\xdd\xc0"
    wire = frame(payload)
    assert wire.count(b"\xc0") == 2
    assert unframe(wire[1:-1]) == payload


def test_hash_is_little_endian_xxh32_with_the_units_seed():
    wire = frame(b"\x21\x01\x02")
    assert wire[-5:-1] == xxhash.xxh32(b"\x21\x01\x02", seed=1425).digest()[::-1]


def test_requests_split_anywhere_are_read_whole():
    reader = RequestReader()
    wire = b"noise" + frame(SUBSCRIBE) + frame(b"\x21\x02\x18")
    payloads = [p for i in range(len(wire)) for p in reader.feed(wire[i : i + 1])]
    assert payloads == [SUBSCRIBE, b"\x21\x02\x18"]
    assert subscription_of(payloads[0]) == {24, 27}
    assert subscription_of(payloads[1]) is None


def test_requests_with_a_wrong_hash_are_ignored_and_the_buffer_stays_bounded():
    reader = RequestReader()
    wire = bytearray(frame(SUBSCRIBE))
    wire[5] ^= 1
    assert reader.feed(bytes(wire)) == []
    reader.feed(bytes(5000))
    assert len(reader._buffer) <= 512


def test_answers_echo_type_and_id():
    reply = answer(SUBSCRIBE)
    assert reply is not None
    assert unframe(reply[1:-1]) == bytes([0x21, 0x80, 0x12, 0x00])
    assert answer(b"\x22\x02\x18") is None
