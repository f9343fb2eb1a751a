import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.drivers.codecs import canopen
from fsw.drivers.wire import Reject


def test_slow_services_decode() -> None:
    assert canopen.decode_heartbeat(b"\x05") == canopen.NmtState.OPERATIONAL
    emergency = canopen.decode_emcy(bytes.fromhex("1023810102030405"))
    assert emergency == canopen.Emergency(0x2310, 0x81, bytes((1, 2, 3, 4, 5)))


def test_commands_encode() -> None:
    assert canopen.encode_sync(240) == (0x080, b"\xf0")
    assert canopen.encode_nmt(canopen.NmtCommand.START, 0x11) == (0x000, b"\x01\x11")


@given(st.binary(max_size=80))
def test_only_the_right_length_of_a_slow_service_decodes(data: bytes) -> None:
    for decode, length in (
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
