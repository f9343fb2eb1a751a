"""Packing and unpacking, against bytes written by hand and the CRC of the standard library."""

import binascii
import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.telemetry.dictionary import DICTIONARY, Type
from fsw.telemetry.link.packets import (
    Decoder,
    Packetizer,
    cuc,
    from_cuc,
    telecommand_packet,
    uplink_file_packet,
)


def crc(data: bytes) -> bytes:
    return struct.pack(">H", binascii.crc_hqx(data, 0xFFFF))


def anything(packet):
    """Values of every field of a packet, all different."""
    values = {}
    for k, field in enumerate(packet.fields, start=1):
        if field.type is Type.TEXT:
            values[field.name] = f"text {k}"
        elif field.type in (Type.F32, Type.F64):
            values[field.name] = k + 0.5
        else:
            values[field.name] = k % 200
    if packet.name == "time":
        values["p_field"] = 0x2F
    return values | dict(packet.match)


def test_a_ping_and_its_answer_are_these_bytes():
    """ECSS-E-ST-70-41C 7.4.3/7.4.4, by hand: version, APID 100, sequence flags 3, length - 1."""
    ping = telecommand_packet(DICTIONARY.telecommand("PING"), {}, 5, ack=0b1001, source=7)
    head = bytes.fromhex("1864 c005 0006 29 11 01 0007")
    assert ping == head + crc(head)
    alive = Packetizer().make("alive", 1_500_000_000, {})
    head = bytes.fromhex("0864 c000 0010 20 11 02 0000 0000 2f 00000001 800000")
    assert alive == head + crc(head)


def test_the_time_packet_has_no_secondary_header():
    t_ns = 0x01020304 * 10**9
    values = {
        "rate_exponent": 4,
        "p_field": 0x2F,
        "coarse_s": 0x01020304,
        "fine": 5,
        "time_status": 0,
    }
    raw = Packetizer().make("time", t_ns, values)
    head = bytes.fromhex("0000 c000 000b 04 2f 01020304 000005 00")
    assert raw == head + crc(head)
    assert Decoder().decode(raw).values["fine"] == 5


@pytest.mark.parametrize("packet", DICTIONARY.packets, ids=lambda p: p.name)
def test_every_packet_comes_back_as_it_was(packet):
    values = anything(packet)
    raw = Packetizer().make(packet.name, 12_345_000_000_000, values)
    told = Decoder().decode(raw)
    assert told.packet is packet
    assert told.values == values
    assert len(raw) == packet.size_bytes + (23 if packet.secondary_header else 8)


def test_counters_run_per_application_and_per_message():
    make, decode = Packetizer(), Decoder()
    told = [decode.decode(make.make(n, 0, {})) for n in ("alive", "alive")]
    disabled = {"n": 0} | {f"event_{k}": 0 for k in range(1, 17)}
    told.append(decode.decode(make.make("disabled_events", 0, disabled)))
    assert [t.sequence for t in told] == [0, 1, 2]
    assert [t.message_counter for t in told] == [0, 1, 0]


def test_counters_wrap_at_14_and_16_bits():
    make, decode = Packetizer(), Decoder()
    for _ in range(1 << 14):
        make.make("alive", 0, {})
    told = decode.decode(make.make("alive", 0, {}))
    assert (told.sequence, told.message_counter) == (0, 1 << 14)


@given(st.integers(0, (1 << 32) * 10**9 - 1))
def test_time_loses_less_than_its_last_bit(t_ns):
    assert len(cuc(t_ns)) == 8
    assert 0 <= t_ns - from_cuc(cuc(t_ns)) < 60


def test_another_time_format_is_refused():
    with pytest.raises(ValueError, match="P-field"):
        from_cuc(b"\x1e" + bytes(7))


def test_what_a_field_cannot_hold_becomes_the_nearest_it_can():
    values = anything(DICTIONARY.packet("estimate"))
    values |= {"nis": math.nan, "condition_number": math.inf, "age_s": 1e300, "blocks": -3}
    values |= {"nis_dof": 70000}
    told = Decoder().decode(Packetizer().make("estimate", 0, values)).values
    assert told["nis"] == 0.0
    assert told["condition_number"] == 1.7976931348623157e308
    assert told["age_s"] == pytest.approx(3.4e38, rel=1e-2)
    assert (told["blocks"], told["nis_dof"]) == (0, 65535)


def test_text_is_cut_between_characters():
    values = anything(DICTIONARY.packet("recorder")) | {"file": "ä" * 100}
    told = Decoder().decode(Packetizer().make("recorder", 0, values))
    assert told.values["file"] == "ä" * 47, "a zero always ends it"


def test_a_missing_value_is_an_error_of_the_program():
    with pytest.raises(KeyError):
        Packetizer().make("recorder", 0, {})


def test_file_units_travel_without_secondary_header():
    assert Packetizer().file_packet(b"abc") == bytes.fromhex("0065 c000 0002") + b"abc"
    assert uplink_file_packet(b"abc", 3) == bytes.fromhex("1065 c003 0002") + b"abc"


@given(st.binary(max_size=80))
def test_arbitrary_bytes_are_no_packet(data):
    with pytest.raises(Exception) as info:  # noqa: PT011 (the library's own, and ours)
        Decoder().decode(data)
    assert type(info.value).__name__ in ("ValueError", "BytesTooShortError", "InvalidTmCrc16Error")
