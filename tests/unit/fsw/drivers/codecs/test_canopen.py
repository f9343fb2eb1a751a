from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.drivers.codecs import canopen
from fsw.drivers.wire import Reject
from tests.support.encoders import tpdo1, tpdo1_fd

GOLDEN = bytes.fromhex("0712cdff2efb092a")  # ICD: q = -1.25 rad, -12.34 N m, 0x09, SYNC 42


def test_tpdo1_decodes_the_icd_vector() -> None:
    pdo = canopen.decode_tpdo1(GOLDEN)
    assert isinstance(pdo, canopen.Tpdo1)
    assert abs(pdo.position_rad + 1.25) < math.tau * 2**-25
    assert pdo.torque_nm == pytest.approx(-12.34)
    assert (pdo.status, pdo.sync_counter) == (0x09, 42)
    assert tpdo1(-1.25, -12.34, 0x09, 42) == GOLDEN


@given(
    st.integers(-(2**31), 2**31 - 1),
    st.integers(-(2**15), 2**15 - 1),
    st.binary(min_size=2, max_size=2),
)
def test_tpdo1_encodes_back_to_its_bytes(position: int, torque: int, tail: bytes) -> None:
    data = struct.pack("<ih", position, torque) + tail
    pdo = canopen.decode_tpdo1(data)
    assert isinstance(pdo, canopen.Tpdo1)
    assert tpdo1(pdo.position_rad, pdo.torque_nm, pdo.status, pdo.sync_counter) == data


def test_fd_tailoring_decodes_every_field() -> None:
    pdo = canopen.decode_fd(tpdo1_fd(0.5, -3.25, 0x0109, 240))
    assert isinstance(pdo, canopen.FdTpdo1)
    assert abs(pdo.position_rad - 0.5) < 4e-7
    assert pdo.torque_nm == pytest.approx(-3.25, abs=1e-9)
    assert pdo.velocity_rad_s == pytest.approx(1234 * math.tau / 2**24)
    assert (pdo.status, pdo.sync_counter) == (0x0109, 240)
    assert (pdo.temperature_c, pdo.device_time_us) == (-7.0, 99)


def test_slow_services_decode() -> None:
    slow = canopen.decode_tpdo2(struct.pack("<ihh", 2**24, -250, 215))
    assert isinstance(slow, canopen.Tpdo2)
    assert slow.velocity_rad_s == pytest.approx(math.tau)
    assert slow.motor_torque_ratio == pytest.approx(-0.25)
    assert slow.temperature_c == pytest.approx(21.5)
    assert canopen.decode_heartbeat(b"\x05") == canopen.NmtState.OPERATIONAL
    emergency = canopen.decode_emcy(bytes.fromhex("1023810102030405"))
    assert emergency == canopen.Emergency(0x2310, 0x81, bytes((1, 2, 3, 4, 5)))


def test_commands_encode() -> None:
    assert canopen.encode_sync(240) == (0x080, b"\xf0")
    assert canopen.encode_nmt(canopen.NmtCommand.START, 0x11) == (0x000, b"\x01\x11")


@given(st.binary(max_size=80))
def test_only_the_right_length_decodes(data: bytes) -> None:
    for decode, length in (
        (canopen.decode_tpdo1, 8),
        (canopen.decode_fd, 20),
        (canopen.decode_tpdo2, 8),
        (canopen.decode_heartbeat, 1),
        (canopen.decode_emcy, 8),
    ):
        assert (decode(data) is Reject.LENGTH) == (len(data) != length)


@pytest.mark.parametrize(
    ("status", "position", "torque"),
    [(0x09, True, True), (0x29, True, True), (0x08, True, False), (0x01, False, True),
     (0x0B, True, False), (0x0D, True, False), (0x19, False, True), (0x49, False, True),
     (0x89, False, True), (0x00, False, False)],
)  # fmt: skip
def test_status_tells_usable_positions_and_torques(
    status: int, position: bool, torque: bool
) -> None:
    assert canopen.position_usable(status) is position
    assert canopen.torque_usable(status) is torque
