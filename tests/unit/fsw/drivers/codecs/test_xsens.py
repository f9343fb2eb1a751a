import struct

import pytest
from crccheck.checksum import Checksum8

from fsw.drivers.codecs.xsens import XsensCodec
from fsw.drivers.wire import Reject
from tests.support.codecs import decoded

# frame of a MTi-630: orientation, fine time, status, counter
MTI_630 = "FAFF36262010103EFC23423F00E028BF018FA73EFEEEB1106004000AF84CE02004000000021020021BC5D4"
# payloads of units with the values that the maker's own tool shows for them; the second one shaken
AT_REST = (
    "1020028D901060040054DBF12010103F7F8911BC111DFA3BA0CEF0BD73257340200CBDDCF9D0BE3C8619411D0B47"
    "40100CB98DB000B9F148003CC9043040300CBCB9892EBB098C003CA7080080200CBA63BC01BC04D63FBB6DE3FE"
    "8030103F800001B591C000B72A0800B6984000E0200400400003"
)
SHAKEN = (
    "102002FB8510600401A498DE2010103F2A1463BED7EFA73CDEE5083F1DCEC940200CC1F246C3C1ECE076C28F853F"
    "40100CBD932CCCBD920A16BE3A6EEC40300C42519464C27B5A5AC1CCC0AE80200C40854D6DC125559EC0908E1F"
    "8030103F7FF8983BAA9EE5BC539EC0BBB9060CC0200C3EDC7439BE752B483FAF9A3F301004000186DEE020040048"
    "1401"
)
REST_RAD_S = (-0.00086874, -0.00810772, -0.00362992)
SHAKEN_RAD_S = (4.16570139, -10.33340263, -4.51734877)
TIME = bytes.fromhex("10600400000019")


def message(payload: bytes, kind: int = 0x36) -> bytes:
    length = (
        bytes((len(payload),)) if len(payload) < 255 else b"\xff" + struct.pack(">H", len(payload))
    )
    body = bytes((0xFF, kind)) + length + payload
    return b"\xfa" + body + bytes((-Checksum8.calc(body) & 0xFF,))


def without(payload: bytes, *items: int) -> bytes:
    """Return a payload without some items."""
    kept, at = b"", 0
    while at < len(payload):
        end = at + 3 + payload[at + 2]
        kept += b"" if int.from_bytes(payload[at : at + 2], "big") in items else payload[at:end]
        at = end
    return kept


@pytest.mark.parametrize(
    ("payload", "ticks", "rate", "force"),
    [
        (AT_REST, 5561329, REST_RAD_S, (-0.10789835, -0.18410529, 9.81525326)),
        (SHAKEN, 27564254, SHAKEN_RAD_S, (-30.28455162, -29.60960007, -71.76024628)),
    ],
)
def test_the_values_are_those_of_the_makers_tool(payload, ticks, rate, force):
    (d,) = decoded(XsensCodec(), message(bytes.fromhex(payload)))
    assert d.counter == ticks
    assert d.w_NS_S_rad_s == pytest.approx(rate, abs=6e-9)
    assert d.f_NS_S_m_s2 == pytest.approx(force, abs=6e-9)
    assert (d.gyro_interval_s, d.acc_interval_s) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("payload", "rate", "velocity"),
    [
        (AT_REST, REST_RAD_S, (-0.00027025, -0.00046021, 0.02453813)),
        (SHAKEN, SHAKEN_RAD_S, (-0.07186279, -0.07130830, -0.18206376)),
    ],
)
def test_increments_stand_in_for_rates(payload, rate, velocity):
    (d,) = decoded(XsensCodec(), message(without(bytes.fromhex(payload), 0x4020, 0x8020)))
    assert tuple(400.0 * x for x in d.w_NS_S_rad_s) == pytest.approx(rate, rel=1e-4, abs=2e-6)
    assert d.f_NS_S_m_s2 == pytest.approx(velocity, abs=6e-9)
    assert (d.gyro_interval_s, d.acc_interval_s) == (None, None)


def test_a_message_of_a_unit_without_inertial_data_says_what_it_lacks():
    codec = XsensCodec()
    assert decoded(codec, bytes.fromhex(MTI_630)) == [None]
    assert "no rate of turn (0x8020)" in codec.lacks()
    assert "fine sample time" not in codec.lacks()


@pytest.mark.parametrize(
    ("form", "data"),
    [
        (0, struct.pack(">3f", 1.5, -2.25, 0.125)),
        (1, struct.pack(">3i", 3 << 19, -9 << 18, 1 << 17)),
        (2, bytes.fromhex("800000000001" "C0000000FFFD" "200000000000")),
        (3, struct.pack(">3d", 1.5, -2.25, 0.125)),
    ],
)  # fmt: skip
def test_every_number_format(form, data):
    payload = TIME + struct.pack(">HB", 0x8020 | form, len(data)) + data
    (d,) = decoded(XsensCodec(), message(payload))
    assert d.w_NS_S_rad_s == (1.5, -2.25, 0.125)
    assert d.f_NS_S_m_s2 is None


@pytest.mark.parametrize(
    ("payload", "found"),
    [
        (struct.pack(">HB3f", 0x8020, 12, 0, 0, 0), Reject.STALE),
        (TIME + struct.pack(">HB3f", 0x8020, 12, float("nan"), 0, 0), Reject.RANGE),
        (TIME + struct.pack(">HB2f", 0x8020, 8, 0, 0), Reject.LENGTH),
        (TIME, None),
    ],
)
def test_messages_that_give_no_sample(payload, found):
    assert decoded(XsensCodec(), message(payload)) == [found]


def test_other_messages_and_long_ones_are_frames():
    long = TIME + struct.pack(">HB", 0x0810, 248) + bytes(248)
    assert decoded(XsensCodec(), message(b"", 0x3E) + message(long)) == [None, None]


def test_items_that_do_not_fill_the_payload_are_no_message():
    codec = XsensCodec()
    assert decoded(codec, message(TIME + b"\x80\x20\x0c\0")) == []
    assert codec.framer.skipped_bytes == 16
