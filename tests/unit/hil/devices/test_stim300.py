import math
from pathlib import Path

import numpy as np
import pytest
from crccheck.crc import Crc32Mpeg2

from hil.devices.stim300 import G_M_S2, Measurements, crc32_mpeg2, encode, layout_of

# Identifier: bytes without CR LF, zero dummies in the CRC (ICD section 2).
TABLE = {
    **dict(zip((0x90, 0x91, 0x92, 0x93), ((18, 2), (28, 0), (28, 0), (38, 2)), strict=True)),
    **dict(zip((0x94, 0xA5, 0xA6, 0xA7), ((25, 3), (42, 2), (42, 2), (59, 1)), strict=True)),
    **dict(zip(range(0xF0, 0xF4), ((22, 2), (32, 0), (32, 0), (42, 2)), strict=True)),
    **dict(zip(range(0xF4, 0xF8), ((29, 3), (46, 2), (46, 2), (63, 1)), strict=True)),
    **dict(zip(range(0x98, 0x9C), ((22, 2), (32, 0), (32, 0), (42, 2)), strict=True)),
    **dict(zip((0x9C, 0xAD, 0xAE, 0xAF), ((29, 3), (46, 2), (46, 2), (63, 1)), strict=True)),
}


def samples(count: int = 1) -> Measurements:
    def row(*values: float) -> np.ndarray:
        return np.tile(np.array(values), (count, 1))

    return Measurements(
        w_NS_S_rad_s=np.radians(row(1.0, 2.0, -3.0)),
        f_NS_S_m_s2=G_M_S2 * row(0.1, -0.2, 0.05),
        inclination_g=row(0.0, 0.0, 1.0),
        gyro_temperature_degc=row(25.0, 25.5, 26.0),
        acc_temperature_degc=row(24.0, 24.5, 25.0),
        incl_temperature_degc=row(23.0, 23.0, 23.0),
        counter=42 + 4 * np.arange(count),
        latency_us=np.full(count, 1234),
        status=np.zeros(count, dtype=np.int64),
    )


def test_datagram_a5_is_the_vector_of_the_icd():
    expected = (
        "a5004000008000ff40000000cccdfe666600666600190019801a0000180018801900002a04d2acdb75c9"
    )
    assert encode(0xA5, samples())[0].hex() == expected


@pytest.mark.parametrize("datagram_id", sorted(TABLE))
def test_every_identifier_has_its_length_and_crc(datagram_id):
    length, dummies = TABLE[datagram_id]
    plain = encode(datagram_id, samples())[0]
    assert len(plain) == length == layout_of(datagram_id).length
    assert plain[0] == datagram_id
    assert Crc32Mpeg2.calc(plain[:-4] + bytes(dummies)) == int.from_bytes(plain[-4:], "big")
    assert encode(datagram_id, samples(), crlf=True)[0] == plain + b"\r\n"


def test_crc_agrees_with_an_independent_library():
    rng = np.random.default_rng(1)
    for length in range(64):
        data = rng.bytes(length)
        assert crc32_mpeg2(data) == Crc32Mpeg2.calc(data)


def test_counter_wraps_at_one_byte():
    counters = [block[-7] for block in encode(0xA5, samples(60))]
    assert counters == [(42 + 4 * k) % 256 for k in range(60)]


def test_values_saturate_at_24_bits():
    big = samples()
    huge = Measurements(
        **{name: getattr(big, name) for name in Measurements.__slots__}
        | {"w_NS_S_rad_s": np.array([[math.radians(600.0), -math.radians(600.0), 0.0]])}
    )
    assert encode(0x90, huge)[0][1:7].hex() == "7fffff800000"


@pytest.mark.parametrize(("acc_range", "lsb"), [(5, 20), (10, 19), (30, 18), (80, 16)])
def test_acceleration_scale_follows_the_range(acc_range, lsb):
    block = encode(0x91, samples(), acc_range)[0]
    assert int.from_bytes(block[11:14], "big", signed=True) == round(0.1 * 2**lsb)


def test_unknown_identifier_is_refused():
    with pytest.raises(ValueError, match="0xA4"):
        layout_of(0xA4)


def test_encoder_shares_no_code_with_the_flight_decoder():
    from hil.devices import stim300

    source = Path(stim300.__file__).read_text(encoding="utf-8")
    assert "fastcrc" not in source
    assert "fsw" not in source
