import struct

import pytest
from crccheck.crc import CrcXmodem

from fsw.drivers.codecs.vectornav import VectorNavCodec
from fsw.drivers.wire import Reject
from tests.support.codecs import decoded

# VN-100 manual UM001, section 4.3: yaw, pitch, roll
ANGLES = bytes.fromhex("FA01080093502E42833EF13F48B504BB9288")
TIME = struct.pack("<Q", 2_000_000)
ONE, TWO = struct.pack("<3f", 1, 2, 3), struct.pack("<3f", 4, 5, 6)
STEP = struct.pack("<7f", 0.5, 90, 0, 0, 1, 2, 3)  # of 0.5 s: 90 deg about x; 1, 2, 3 m/s


def packet(masks: dict[int, int], body: bytes) -> bytes:
    """Return a packet with the masks of groups, by their number, as the manual lays it out."""
    groups = bytes((sum(1 << group - 1 for group in masks),))
    data = groups + struct.pack(f"<{len(masks)}H", *masks.values()) + body
    return b"\xfa" + data + CrcXmodem.calcbytes(data)


def test_the_packet_of_the_manual_has_no_inertial_data():
    codec = VectorNavCodec()
    assert decoded(codec, ANGLES) == [None]
    assert codec.lacks().startswith("no time since start-up (group 1 bit 0) and no rate")


@pytest.mark.parametrize(
    ("masks", "body", "rate", "force", "interval_s"),
    [
        ({1: 0x0121}, TIME + ONE + TWO, (1, 2, 3), (4, 5, 6), 0.0),
        ({1: 0x0201}, TIME + ONE + TWO, (4, 5, 6), (1, 2, 3), 0.0),  # Imu: acceleration first
        ({1: 0x0001, 3: 0x0600}, TIME + ONE + TWO, (4, 5, 6), (1, 2, 3), 0.0),
        ({1: 0x0101, 3: 0x0408}, TIME + TWO + ONE + TWO, (1, 2, 3), (4, 5, 6), 0.0),
        ({2: 0x0001, 3: 0x000C}, TIME + ONE + TWO, (4, 5, 6), (1, 2, 3), 0.0),
        ({1: 0x0801}, TIME + STEP, (3.1415927, 0, 0), (2, 4, 6), 0.5),
        ({1: 0x0001, 3: 0x00C0}, TIME + STEP, (3.1415927, 0, 0), (2, 4, 6), 0.5),
    ],
)  # fmt: skip
def test_fields_of_every_group(masks, body, rate, force, interval_s):
    (d,) = decoded(VectorNavCodec(), packet(masks, body))
    assert d.counter == 2_000_000
    assert d.w_NS_S_rad_s == pytest.approx(rate)
    assert d.f_NS_S_m_s2 == pytest.approx(force)
    assert (d.gyro_interval_s, d.acc_interval_s) == (interval_s, interval_s)


@pytest.mark.parametrize(
    ("masks", "body", "found"),
    [
        ({1: 0x0120}, ONE + TWO, Reject.STALE),
        ({1: 0x0021}, TIME + struct.pack("<3f", 0, float("inf"), 0), Reject.RANGE),
        ({1: 0x0801}, TIME + struct.pack("<7f", 0.0, *6 * [1.0]), None),  # no interval
    ],
)
def test_packets_that_give_no_sample(masks, body, found):
    assert decoded(VectorNavCodec(), packet(masks, body)) == [found]


def test_masks_of_unknown_length_are_no_packet():
    for groups, mask in ((0x80, 1), (0x40, 1), (0x01, 0x8000), (0x02, 0x0400), (0x01, 0)):
        codec = VectorNavCodec()
        data = bytes((0xFA, groups)) + struct.pack("<H", mask) + bytes(40)
        assert decoded(codec, data + packet({1: 0x0121}, TIME + ONE + TWO))[-1] is not None
        assert codec.framer.skipped_bytes == len(data)
