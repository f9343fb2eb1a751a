"""The plant's own reader and writer of python-can's udp_multicast, beside python-can's."""

import os
import select
import socket
import time
from collections.abc import Iterator

import can
import pytest
from can.interfaces.udp_multicast.utils import pack_message
from hypothesis import given
from hypothesis import strategies as st

from hil.devices.datagrams import SLOTS
from hil.devices.multicast import MulticastPort, datagram
from hil.devices.plant_file import BusLink

GROUP, PORT = "239.74.163.2", 44_000 + os.getpid() % 900
LENGTHS = (0, 1, 8, 20, 64)


def message(can_id: int, data: bytes, *, is_fd: bool = False) -> can.Message:
    return can.Message(
        arbitration_id=can_id,
        data=data,
        is_extended_id=False,
        is_fd=is_fd,
        bitrate_switch=is_fd,
    )


@pytest.fixture
def host() -> Iterator[can.BusABC]:
    with can.Bus(interface="udp_multicast", channel=GROUP, port=PORT, fd=True) as bus:
        yield bus


@pytest.fixture
def port() -> Iterator[MulticastPort]:
    end = MulticastPort(
        BusLink(name="arm", interface="udp_multicast", channel=GROUP, port=PORT, fd=True)
    )
    yield end
    end.close()


def heard(port: MulticastPort) -> list[tuple[int, bytes]]:
    """Return what comes until the bus has been quiet for a while."""
    frames = []
    while select.select([port], (), (), 0.3)[0]:
        frames += [(can_id, data) for _, can_id, data in port.receive()]
    return frames


@given(st.integers(0, 0x7FF), st.sampled_from(LENGTHS), st.data())
def test_a_datagram_is_python_can_s_to_the_byte(can_id, length, draw):
    data, is_fd = draw.draw(st.binary(min_size=length, max_size=length)), length > 8
    expected = pack_message(message(can_id, data, is_fd=is_fd))
    assert datagram(can_id, data, is_fd=is_fd) == expected


def test_python_can_receives_every_frame_of_several_batches_in_order(host, port):
    sent = [(0, 0x181 + k % 7, bytes([k]) * (20 if k % 2 else 8), k % 2 == 1) for k in range(70)]
    assert len(sent) > 2 * SLOTS
    assert port.send(sent) == 0
    received = [host.recv(5.0) for _ in sent]
    assert [(m.arbitration_id, bytes(m.data), m.is_fd) for m in received] == [f[1:] for f in sent]
    assert all(m.bitrate_switch == m.is_fd and not m.is_extended_id for m in received)


def test_frames_that_no_node_hears_end_in_the_kernel(host, port):
    port.send([(0, 0x191, bytes(8), False), (0, 0x291, bytes(8), False)])
    for can_id in (0x185, 0x591, 0x5FF):
        host.send(message(can_id, bytes(8)))
    assert select.select([port], (), (), 0.3)[0] == []
    wanted = [0x000, 0x080, 0x600, 0x611, 0x701, 0x7FF]
    for can_id in (*wanted, 0x081, 0x100, 0x180):
        host.send(message(can_id, b"\x01\x11"))
    host.send(can.Message(arbitration_id=0x080, data=b"\x05", is_extended_id=True))
    assert heard(port) == [(can_id, b"\x01\x11") for can_id in wanted]
    assert port.receive_errors == 0


def test_a_frame_has_the_stamp_of_the_kernel(host, port):
    before_ns = time.time_ns()
    host.send(message(0x080, b"\x07"))
    after_ns = time.time_ns()
    time.sleep(0.05)
    ((stamp_ns, _, data),) = port.receive()
    assert data == b"\x07"
    assert before_ns <= stamp_ns < after_ns + 25_000_000


@pytest.mark.parametrize("junk", [b"\xff" * 120, b"\x80" + bytes(120), b"n" * 200])
def test_a_datagram_that_is_no_frame_is_counted_and_stops_nothing(host, port, junk):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(junk, (GROUP, PORT))
        sender.sendto(b"short", (GROUP, PORT))
    host.send(message(0x080, b"\x09"))
    assert heard(port) == [(0x080, b"\x09")]
    assert port.receive_errors == 1


def test_a_bus_without_can_fd_sends_and_hears_classic_frames_only(host):
    link = BusLink(name="arm", interface="udp_multicast", channel=GROUP, port=PORT)
    port = MulticastPort(link)
    try:
        frames = [(0, 0x191, bytes(20), True), (0, 0x192, b"\x01", False)]
        assert port.send(frames) == 1
        assert host.recv(5.0).arbitration_id == 0x192
        host.send(message(0x080, b"\x03", is_fd=True))
        host.send(message(0x080, b"\x04"))
        assert heard(port) == [(0x080, b"\x04")]
    finally:
        port.close()
