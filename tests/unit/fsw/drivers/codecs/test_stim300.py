import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.drivers.codecs import stim300
from fsw.drivers.codecs.framing import Framer
from fsw.drivers.codecs.stim300 import Stim300Codec, StimDatagram, StimMatcher, decode_datagram
from fsw.drivers.wire import ByteChunk, Reject
from tests.support.encoders import ACC_BITS, GRAVITY, KINDS, LENGTHS, Stim

GOLDEN = bytes.fromhex(  # ICD section 2
    "a5004000008000ff40000000cccdfe666600666600190019801a0000180018801900002a04d2acdb75c9"
)


@st.composite
def datagrams(draw: st.DrawFn, identifier: int | None = None) -> Stim:
    kind = draw(st.sampled_from(sorted(KINDS))) if identifier is None else identifier
    values, status = {}, {}
    for cluster in KINDS[kind]:
        bits = 15 if cluster.isupper() else 23
        number = st.integers(-(2**bits), 2**bits - 1)
        values[cluster] = draw(st.tuples(number, number, number))
        status[cluster] = draw(st.integers(0, 255))
    return Stim(kind, values, status, draw(st.integers(-(2**23), 2**23 - 1)),
                draw(st.integers(0, 255)), draw(st.integers(0, 65535)))  # fmt: skip


def reencode(d: StimDatagram, acc_range_g: int) -> bytes:
    def raw(v: tuple[float, float, float] | None, scale: float) -> tuple[int, int, int]:
        x, y, z = v or (0.0, 0.0, 0.0)
        return round(x / scale), round(y / scale), round(z / scale)

    values = {
        "g": raw(d.gyro_rad_s, math.pi / 180 / 2**14),
        "a": raw(d.acc_m_s2, GRAVITY / 2 ** ACC_BITS[acc_range_g]),
        "i": raw(d.incl_m_s2, GRAVITY / 2**22),
        "G": raw(d.gyro_temperature_c, 1 / 256),
        "A": raw(d.acc_temperature_c, 1 / 256),
        "I": raw(d.incl_temperature_c, 1 / 256),
    }
    status = dict(zip("gaiGAIx", (d.gyro_status, d.acc_status, d.incl_status,
                                  *d.temperature_status, d.extra_status), strict=True))  # fmt: skip
    return Stim(d.identifier, values, status, d.extra or 0, d.counter, d.latency_us).encode()


def frames(
    data: bytes, crlf: bool = False, cuts: tuple[int, ...] = ()
) -> tuple[list[bytes], Framer]:
    framer = Framer(StimMatcher(crlf))
    out = []
    for start, stop in zip((0, *cuts), (*cuts, len(data)), strict=True):
        out += [f.data for f in framer.feed(ByteChunk(0, data[start:stop]))]
        assert framer.pending_bytes < 65
    assert framer.received_bytes == len(data)
    assert sum(map(len, out)) + framer.skipped_bytes + framer.pending_bytes == len(data)
    return out, framer


def test_icd_vector() -> None:
    d = decode_datagram(GOLDEN, 10)
    assert isinstance(d, StimDatagram)
    assert [math.degrees(x) for x in d.gyro_rad_s] == pytest.approx([1.0, 2.0, -3.0])
    assert d.acc_m_s2 is not None
    assert [x / GRAVITY for x in d.acc_m_s2] == pytest.approx([0.1, -0.2, 0.05], abs=2**-19)
    assert d.gyro_temperature_c == (25.0, 25.5, 26.0)
    assert d.acc_temperature_c == (24.0, 24.5, 25.0)
    assert (d.counter, d.latency_us) == (42, 1234)


def test_lengths_are_those_of_the_data_sheet() -> None:
    assert {k: v.length for k, v in stim300.LAYOUTS.items()} == LENGTHS


@given(datagrams(), st.sampled_from(sorted(ACC_BITS)), st.booleans())
def test_a_datagram_encodes_back_to_its_bytes(stim: Stim, acc_range_g: int, crlf: bool) -> None:
    data = stim.encode()
    decoded = decode_datagram(stim.encode(crlf), acc_range_g)
    assert isinstance(decoded, StimDatagram)
    assert reencode(decoded, acc_range_g) == data


@pytest.mark.parametrize("identifier", sorted(KINDS))
@pytest.mark.parametrize("crlf", [False, True])
def test_every_single_bit_flip_is_rejected(identifier: int, crlf: bool) -> None:
    good = Stim(identifier, {"g": (1, -2, 3)}, counter=9, latency_us=700).encode(crlf)
    for bit in range(8 * len(good)):
        bad = bytearray(good)
        bad[bit // 8] ^= 1 << bit % 8
        found, framer = frames(good + bytes(bad) + good + good, crlf)
        assert found == [good] * 3, bit
        assert sum(framer.rejects.values()) >= 1


@given(datagrams(), st.booleans())
def test_split_at_every_byte(stim: Stim, crlf: bool) -> None:
    good = stim.encode(crlf)
    for cut in range(1, 2 * len(good)):
        assert frames(2 * good, crlf, (cut,))[0] == [good, good]
    assert frames(2 * good, crlf, tuple(range(1, 2 * len(good))))[0] == [good, good]


@given(datagrams(), st.binary(max_size=200))
def test_a_datagram_behind_junk_is_found(stim: Stim, junk: bytes) -> None:
    good = stim.encode()
    found, framer = frames(junk + 3 * good)
    assert found[-1] == good
    assert framer.skipped_bytes >= min(1, len(junk))


@given(st.binary(max_size=300), st.booleans())
def test_arbitrary_bytes_never_raise(data: bytes, crlf: bool) -> None:
    frames(data, crlf)
    decode_datagram(data, 10)


def test_wrong_trailer_and_length_are_refused() -> None:
    assert decode_datagram(GOLDEN + b"\r\r", 10) is Reject.LENGTH
    assert decode_datagram(GOLDEN[:-1], 10) is Reject.LENGTH
    assert decode_datagram(b"\x00" + GOLDEN[1:], 10) is Reject.SYNC
    assert frames(GOLDEN + b"\r\r" + GOLDEN + b"\r\n", crlf=True)[0] == [GOLDEN + b"\r\n"]


def test_another_kind_of_datagram_is_taken_up_after_a_while() -> None:
    other = Stim(0x91).encode()
    found, _ = frames(GOLDEN + 80 * other)
    assert found[0] == GOLDEN
    assert len(found) >= 80 - 1024 // 28


@pytest.mark.parametrize("bit", [0x80, 0x40, 0x10, 0x08])
def test_a_flagged_cluster_is_unusable_and_the_other_is_not(bit: int) -> None:
    codec = Stim300Codec(10, crlf=False)
    for cluster in "ga":
        stim = Stim(0xA5, {"g": (1, 1, 1), "a": (1, 1, 1)}, {cluster: bit | 0x07})
        (frame,) = codec.framer.feed(ByteChunk(0, stim.encode()))
        d = codec.decode(frame)
        assert not isinstance(d, Reject)
        assert (d.w_NS_S_rad_s is None, d.f_NS_S_m_s2 is None) == (cluster == "g", cluster == "a")


def test_outside_conditions_are_flagged_only() -> None:
    codec = Stim300Codec(10, crlf=False)
    stim = Stim(0xA5, status={"g": 0x20, "a": 0x21})
    (frame,) = codec.framer.feed(ByteChunk(0, stim.encode()))
    d = codec.decode(frame)
    assert not isinstance(d, Reject)
    assert d.w_NS_S_rad_s is not None
    assert d.f_NS_S_m_s2 is not None
    assert (d.gyro_status, d.acc_status) == (0x20, 0x21)
