"""Time on the wire of a frame: bits counted by hand from ISO 11898-1:2015, without stuff bits."""

import pytest

from fsw.drivers.layout.signals import Message
from fsw.drivers.sources.validity import wire_s
from tests.support.driver_configs import bus_config

FAST = {"fd": True, "bitrate": 1_000_000, "data_bitrate": 5_000_000}
CLASSIC_BITS = 1 + 11 + 3 + 4 + 64 + 16 + 2 + 7 + 3  # identifier, control, CRC, ACK, EOF, pause
BASE_BITS = 1 + 11 + 5 + 1 + 2 + 7 + 3  # SOF to BRS; CRC delimiter, ACK, EOF, pause
FD_BITS = 1 + 4 + 96 + 4 + 17 + 6  # ESI, DLC, 12 bytes, stuff count, CRC, fixed stuff bits


@pytest.mark.parametrize(
    ("bus", "is_extended", "length", "expected_us"),
    [
        ({}, False, 8, CLASSIC_BITS),
        ({}, True, 8, CLASSIC_BITS + 20),
        ({"bitrate": 500_000}, False, 8, 2 * CLASSIC_BITS),
        (FAST, False, 12, BASE_BITS + FD_BITS / 5),
        (FAST, True, 12, BASE_BITS + 19 + FD_BITS / 5),
        (FAST, False, 20, BASE_BITS + (FD_BITS + 64 + 4 + 1) / 5),  # a CRC of 21 bits
    ],
)
def test_the_time_of_a_frame_on_the_wire(bus, is_extended, length, expected_us):
    message = Message(name="m", identifier=1, is_extended=is_extended, length=length, signals=())
    assert wire_s(message, bus_config(**bus)) == pytest.approx(1e-6 * expected_us)
