import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.drivers.codecs import sagitta
from fsw.drivers.codecs.framing import Framer
from fsw.drivers.codecs.sagitta import SagittaCodec, SlipMatcher, Solution, Telemetry
from fsw.drivers.wire import ByteChunk, Reject
from tests.support.encoders import slip, solution

Q = (0.5, -0.5, 0.5, 0.5)


def frames(data: bytes, cuts: tuple[int, ...] = ()) -> tuple[list[bytes], Framer]:
    framer = Framer(SlipMatcher())
    out = []
    for start, stop in zip((0, *cuts), (*cuts, len(data)), strict=True):
        out += [f.data for f in framer.feed(ByteChunk(0, data[start:stop]))]
        assert framer.pending_bytes <= sagitta.MAX_FRAME_BYTES
    assert sum(map(len, out)) + framer.skipped_bytes + framer.pending_bytes == len(data)
    return out, framer


def test_icd_vectors() -> None:
    assert sagitta.encode(bytes((0x21, 3, 1, 1))) == bytes.fromhex("c0210301019c349a61c0")
    assert sagitta.encode(bytes((0x21, 2, 24))) == bytes.fromhex("c0210218ac15e176c0")
    subscribe = bytes.fromhex("c02100 12181b" + "00" * 14 + "c6b9fe6cc0")
    assert sagitta.encode_subscribe((24, 27)) == subscribe


@given(st.binary(min_size=1, max_size=200))
def test_framing_agrees_with_an_independent_one(payload: bytes) -> None:
    assert sagitta.encode(payload) == slip(payload)
    assert sagitta.decode_payload(slip(payload)) == payload


def test_solution_decodes_every_field() -> None:
    decoded = SagittaCodec().decode(solution(Q, ticks=0xDBC0, unix_us=1_700_000_000_000_000))
    assert isinstance(decoded, Solution)
    assert decoded.q_wxyz == Q
    assert (decoded.ticks, decoded.unix_us) == (0xDBC0, 1_700_000_000_000_000)
    assert (decoded.confidence, decoded.lost_in_space_quality) == (0.5, 0.25)
    counts = (decoded.stars_removed, decoded.stars_centroided, decoded.stars_matched)
    assert counts == (3, 20, 17)
    assert decoded.lost_in_space_stars == 9
    assert (decoded.mode, decoded.valid, decoded.stable_count, decoded.strategy) == (0, True, 77, 1)
    assert len(sagitta.unescape(solution(Q)[1:-1]) or b"") == 87


@pytest.mark.parametrize(
    ("q", "valid", "reason"),
    [
        (Q, 0, Reject.STATUS),
        ((1.0, 0.1, 0.0, 0.0), 1, Reject.RANGE),
        ((math.nan, 0.0, 0.0, 0.0), 1, Reject.RANGE),
        ((math.inf, 0.0, 0.0, 0.0), 1, Reject.RANGE),
        ((0.0, 0.0, 0.0, 0.0), 1, Reject.RANGE),
    ],
)
def test_unusable_solutions_are_rejected(q: tuple[float, ...], valid: int, reason: Reject) -> None:
    assert SagittaCodec().decode(solution(q, valid=valid)) is reason


def test_wrong_length_and_address_are_rejected() -> None:
    head = struct.pack("<4BIQ", 0x21, 0x84, 24, 0, 1, 1)
    assert SagittaCodec().decode(slip(head + bytes(66))) is Reject.LENGTH
    assert SagittaCodec().decode(solution(Q, address=0x22)) is Reject.NODE


def test_replies_are_no_solutions() -> None:
    for payload in (b"\x21\x80\x12\x00", struct.pack("<4BIQ", 0x21, 0x83, 1, 0, 5, 6) + b"\1"):
        assert isinstance(SagittaCodec().decode(slip(payload)), Telemetry)


def test_every_single_bit_flip_is_rejected() -> None:
    good = solution((0.1, 0.7, 0.1, 0.7), ticks=0xC0DB)
    for bit in range(8 * len(good)):
        bad = bytearray(good)
        bad[bit // 8] ^= 1 << bit % 8
        found, framer = frames(good + bytes(bad) + good)
        assert found == [good] * 2, bit
        assert sum(framer.rejects.values()) >= 1


@given(st.binary(min_size=1, max_size=60), st.binary(max_size=80))
def test_split_at_every_byte_and_junk_before(payload: bytes, junk: bytes) -> None:
    good = slip(payload)
    for cut in range(1, 2 * len(good)):
        assert frames(2 * good, (cut,))[0] == [good, good]
    assert frames(junk + good)[0][-1] == good


@given(st.binary(max_size=3000))
def test_arbitrary_bytes_never_raise(data: bytes) -> None:
    frames(data)
    codec = SagittaCodec()
    for payload in (data[:100], b"\x21\x84\x18" + data[:84]):
        if payload:
            codec.decode(slip(payload))
