import math
import struct

import pytest

from fsw.drivers.codecs.novatel import NovatelCodec, check_value
from fsw.drivers.wire import Reject
from tests.support.codecs import decoded

# tests of NovAtel's own EDIE decoder have this log as bytes and as text:
# %RAWIMUSXA,1692,484620.664;00,11,1692,484620.664389000,00801503,
# 43110635,-817242,-202184,-215194,-41188,-9895
HG1700 = bytes.fromhex(
    "AA441328B6059C0678B9E21C000B9C060B9755A832941D4103158000EBD09102A687F3FF38EAFCFF66B7FCFF"
    "1C5FFFFF59D9FFFF475FAFBA"
)
# a log of a receiver with a STIM300 at rest, 125 samples a second
STIM300 = bytes.fromhex(
    "AA441328B605290818677A01002029083D26F7E0BE37D84000000B0FAF0605006208000030E8FFFF6F000000"
    "3E00000054FFFFFF8BE5610C"
)
# logs of other kinds: 2264 with a short header, 812 with a long one
CORRIMUS = bytes.fromhex(
    "AA44133CD80835081044DA0816000000B46091118E51023F428A9C63D293D9BE7B6B13A3DFD117BFC0E0E09903"
    "7A4EBF33FC5F801BF93FBFF8DD023C112FEDBE90C2394100000000839409ED"
)
CORRIMUDATA = bytes.fromhex(
    "AA44121C2C0300A03C0000005BB41C074C8C8C0900000000BABDC4321C070000333333336F8E0341FC5267D115"
    "99D03EC3FECAE9E043C83EB0A617CFD06CC73E0D456591F37F44BF0003BF3E9F4E363F52E8C571BA7FD5BE5E59"
    "F71B"
)


def sealed(data: bytes) -> bytes:
    return data + check_value(data)


def test_the_log_of_the_maker_is_its_text():
    (d,) = decoded(NovatelCodec(), HG1700)
    assert d.counter == 1692 * 604_800_000_000 + 484_620_664_389
    velocity_m_s = [n * 2.0**-27 * 0.3048 for n in (-202184, 817242, 43110635)]
    assert d.f_NS_S_m_s2 == pytest.approx(tuple(velocity_m_s), rel=1e-12)
    angle_rad = [n * 2.0**-33 for n in (-9895, 41188, -215194)]
    assert d.w_NS_S_rad_s == pytest.approx(tuple(angle_rad), rel=1e-12)
    assert (d.gyro_interval_s, d.acc_interval_s) == (None, None)
    assert d.f_NS_S_m_s2[2] * 100.0 == pytest.approx(9.8, abs=0.02)  # at rest


def test_a_unit_at_rest_measures_gravity():
    (d,) = decoded(NovatelCodec(), STIM300)
    assert math.hypot(*d.f_NS_S_m_s2) * 125.0 == pytest.approx(9.82, abs=0.02)
    assert math.hypot(*d.w_NS_S_rad_s) * 125.0 < 5e-4


def test_other_logs_are_frames_without_a_sample():
    codec = NovatelCodec()
    assert decoded(codec, CORRIMUS + CORRIMUDATA) == [None, None]
    assert codec.lacks() == "no raw inertial data (268, 325, 1461, 1462), found logs 812, 2264"
    assert decoded(codec, HG1700) != [None]
    assert codec.lacks() == ""


def test_logs_without_the_type_of_the_unit_need_it_as_an_option():
    head = bytes.fromhex("AA4413284501") + bytes(6)  # RAWIMUS
    log = sealed(head + struct.pack("<IdI6i", 1692, 10.0, 0, *struct.unpack("<6i", HG1700[28:52])))
    codec = NovatelCodec()
    assert decoded(codec, log) == [Reject.STATUS]
    assert codec.lacks() == "the scale of unit 0 is not known; see imu.options"
    (d,), (same,) = decoded(NovatelCodec(unit=11), log), decoded(NovatelCodec(), HG1700)
    assert (d.w_NS_S_rad_s, d.f_NS_S_m_s2) == (same.w_NS_S_rad_s, same.f_NS_S_m_s2)
    (d,) = decoded(NovatelCodec(angle_scale_rad=1e-6, velocity_scale_m_s=1e-5), log)
    assert d.w_NS_S_rad_s == pytest.approx((-9895e-6, 41188e-6, -215194e-6))


@pytest.mark.parametrize(
    ("at", "data", "reason"),
    [
        (12, b"\x01", Reject.STATUS),  # the receiver says: error of the unit
        (12, b"\x02", Reject.STATUS),  # encrypted
        (13, b"\x21", Reject.STATUS),  # KVH 1750: no scale that sources agree on
        (16, struct.pack("<d", float("nan")), Reject.RANGE),
    ],
)
def test_logs_that_give_no_sample(at, data, reason):
    changed = bytearray(HG1700[:-4])
    changed[at : at + len(data)] = data
    assert decoded(NovatelCodec(), sealed(bytes(changed))) == [reason]


def test_a_log_of_a_wrong_length_is_rejected():
    changed = bytearray(HG1700[:-4] + bytes(4))
    changed[3] += 4
    assert decoded(NovatelCodec(), sealed(bytes(changed))) == [Reject.LENGTH]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"unit": 33}, "unit: 33; must be one of"),
        ({"angle_scale_rad": 1e-9}, "both must be"),
        ({"angle_scale_rad": 1e-9, "velocity_scale_m_s": float("nan")}, "both must be"),
    ],
)
def test_wrong_options_are_refused(options, words):
    with pytest.raises(ValueError, match=words):
        NovatelCodec(**options)
