import struct

import pytest
from crccheck.crc import Crc32Mpeg2

from fsw.drivers.codecs.imu_datagram import ImuDatagram
from fsw.drivers.codecs.kvh import KvhCodec
from fsw.drivers.wire import Reject
from tests.support.codecs import decoded
from tests.support.encoders import GRAVITY

# test/utest.cpp of github.com/TRECVT/ros_kvh1750 (BSD): all valid, gyros invalid, wrong check value
VALID = "FE81FF55B3D0BBE732193EF430AC19A5BA8F78D63A2905943F7ECBD47768001DADC5F651"
GYROS_INVALID = "FE81FF553B041F78B9B96613BA234B38BB7C0410B8DEF4803F7F4B7B701F001DF12FB6EE"
WRONG = "FE81FF55B46B86C6B44F5B83B4106D09BB713CB7BBABD9143F7E319A7769001D95BBDB4F"


def codec(**options: object) -> KvhCodec:
    return KvhCodec(**{"rate_hz": 500.0, "rotation": "rate", "acceleration": "value"} | options)


def test_the_message_of_a_unit():
    (d,) = decoded(codec(), bytes.fromhex(VALID))
    assert (d.counter, d.gyro_status, d.acc_status) == (104, 0, 0)
    assert d.w_NS_S_rad_s == pytest.approx((-9.72e-8, 8.92e-9, 1.252e-9), rel=1e-3)
    g = tuple(x / GRAVITY for x in d.f_NS_S_m_s2)
    assert g == pytest.approx((-0.0010946, 0.0006448, 0.9952977), abs=5e-8)
    assert (d.gyro_interval_s, d.acc_interval_s) == (0.0, 0.0)


def test_gyros_that_the_unit_calls_invalid_are_not_used():
    (d,) = decoded(codec(), bytes.fromhex(GYROS_INVALID))
    assert (d.counter, d.gyro_status, d.acc_status, d.w_NS_S_rad_s) == (31, 7, 0, None)
    assert d.f_NS_S_m_s2[2] / GRAVITY == pytest.approx(0.9972455, abs=5e-8)


def test_a_wrong_check_value_is_no_message():
    reader = codec()
    assert decoded(reader, bytes.fromhex(VALID + WRONG + VALID)).count(None) == 0
    assert reader.framer.rejects[Reject.CRC] == 1


def test_settings_of_the_unit_are_options():
    options = {"rotation": "delta", "rotation_unit": "deg", "acceleration": "delta"}
    (d,) = decoded(codec(**options, acceleration_unit="m_s2"), bytes.fromhex(VALID))
    assert d.w_NS_S_rad_s[0] == pytest.approx(-9.72e-8 * 0.0174532925, rel=1e-3)
    assert d.f_NS_S_m_s2[2] == pytest.approx(0.9952977, abs=5e-8)
    assert (d.gyro_interval_s, d.acc_interval_s) == (None, None)


@pytest.mark.parametrize(
    ("rate", "sequence", "reason"),
    [(float("nan"), 0, Reject.RANGE), (0.0, 128, Reject.SEQUENCE)],
)
def test_impossible_values_are_rejected(rate, sequence, reason):
    body = bytes.fromhex("FE81FF55") + struct.pack(">6f2Bh", rate, *5 * [0.0], 0x77, sequence, 20)
    assert decoded(codec(), body + Crc32Mpeg2.calcbytes(body)) == [reason]


def test_a_sequence_number_is_a_period_of_the_declared_rate():
    assert isinstance(decoded(codec(), bytes.fromhex(VALID))[0], ImuDatagram)
    assert (codec(rate_hz=250.0).tick_s, codec().modulus) == (4e-3, 128)
