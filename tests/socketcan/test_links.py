"""The links `hil vcan` gives a command."""

from __future__ import annotations

import can
import pytest


@pytest.mark.parametrize("channel", ["vcan0", "vcan1"])
@pytest.mark.parametrize(("fd", "length"), [(False, 8), (True, 64)])
def test_both_frame_formats_pass_between_two_ends(channel, fd, length):
    sent = can.Message(
        arbitration_id=0x191,
        data=bytes(range(length)),
        is_extended_id=False,
        is_fd=fd,
        bitrate_switch=fd,
    )
    with (
        can.Bus(interface="socketcan", channel=channel, fd=fd) as one,
        can.Bus(interface="socketcan", channel=channel, fd=fd) as other,
    ):
        one.send(sent)
        got = other.recv(10.0)
    assert got is not None
    assert sent.equals(got, timestamp_delta=None, check_channel=False, check_direction=False)
