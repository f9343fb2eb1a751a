import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.drivers.codecs import canopen
from fsw.drivers.wire import Reject
from tests.support.encoders import tpdo1, tpdo1_fd


def octets(*frames: bytes) -> np.ndarray:
    return np.array([list(data) for data in frames], np.uint8)


GOLDEN = bytes.fromhex("0712cdff2efb092a")  # ICD: q = -1.25 rad, -12.34 N m, 0x09, SYNC 42


def test_tpdo1_decodes_the_icd_vector() -> None:
    pdo = canopen.decode_tpdo1(octets(GOLDEN))
    assert abs(pdo.position_rad[0] + 1.25) < math.tau * 2**-25
    assert pdo.torque_nm == pytest.approx([-12.34])
    assert (pdo.status.tolist(), pdo.sync_counter.tolist()) == ([0x09], [42])
    assert tpdo1(-1.25, -12.34, 0x09, 42) == GOLDEN


raw_frames = st.lists(
    st.tuples(
        st.integers(-(2**31), 2**31 - 1),
        st.integers(-(2**15), 2**15 - 1),
        st.binary(min_size=2, max_size=2),
    ),
    min_size=1,
    max_size=5,
)


@given(raw_frames)
def test_tpdo1_encodes_back_to_its_bytes(raw: list[tuple[int, int, bytes]]) -> None:
    frames = [struct.pack("<ih", position, torque) + tail for position, torque, tail in raw]
    pdo = canopen.decode_tpdo1(octets(*frames))
    columns = pdo.position_rad, pdo.torque_nm, pdo.status, pdo.sync_counter
    again = [tpdo1(*values) for values in zip(*(c.tolist() for c in columns), strict=True)]
    assert again == frames


def test_fd_tailoring_decodes_every_field() -> None:
    frames = tpdo1_fd(0.5, -3.25, 0x0109, 240), tpdo1_fd(-0.5, 3.5, 0x09, 1)
    pdo = canopen.decode_fd(octets(*frames))
    assert np.abs(pdo.position_rad - [0.5, -0.5]).max() < 4e-7
    assert pdo.torque_nm == pytest.approx([-3.25, 3.5], abs=1e-9)
    assert pdo.velocity_rad_s == pytest.approx([1234 * math.tau / 2**24] * 2)
    assert (pdo.status.tolist(), pdo.sync_counter.tolist()) == ([0x0109, 9], [240, 1])
    assert (pdo.temperature_c.tolist(), pdo.device_time_us.tolist()) == ([-7.0] * 2, [99] * 2)


def test_the_first_bytes_of_wider_rows_decode_alike() -> None:
    wide = np.zeros((3, 64), np.uint8)
    wide[:, :8] = list(GOLDEN)
    pdo = canopen.decode_tpdo1(wide[:, :8])
    assert pdo.sync_counter.tolist() == [42] * 3
    assert np.abs(pdo.position_rad + 1.25).max() < math.tau * 2**-25


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
def test_only_the_right_length_of_a_slow_service_decodes(data: bytes) -> None:
    for decode, length in (
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
    several = np.array([status, 0x09, status])
    assert canopen.position_usable(several).tolist() == [position, True, position]
    assert canopen.torque_usable(several).tolist() == [torque, True, torque]
