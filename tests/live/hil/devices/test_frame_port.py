"""The devices' end of `udp_frames`; that of SocketCAN is tested in tests/long/socketcan."""

import os
import select
import socket
import struct
import time
from collections.abc import Iterator

import pytest

from fsw.clock import MonotonicClock
from fsw.drivers.ports.can_bus import open_can
from fsw.drivers.wire import frame_list
from hil.devices.datagrams import SLOTS
from hil.devices.frame_port import FramePort
from hil.devices.plant_file import BusLink
from tests.support.driver_configs import bus_config

GROUP, PORT = "239.74.163.3", 45_000 + os.getpid() % 900


def linux_frame(word: int, data: bytes, room: int = 8, flags: int = 0) -> bytes:
    """Lay a frame out as networking/can.rst does."""
    return struct.pack("=IBBBB", word, len(data), flags, 0, 0) + data.ljust(room, b"\0")


def device_end(*, fd: bool) -> FramePort:
    return FramePort(BusLink(name="arm", interface="udp_frames", channel=GROUP, port=PORT, fd=fd))


@pytest.fixture(params=[True, False])
def port(request: pytest.FixtureRequest) -> Iterator[FramePort]:
    end = device_end(fd=request.param)
    yield end
    end.close()


def heard(port: FramePort) -> list[tuple[int, int, bytes]]:
    """Return what comes until the bus has been quiet for a while."""
    frames = []
    while select.select([port], (), (), 0.3)[0]:
        frames += port.receive()
    return frames


def test_nodes_hear_base_frames_of_their_identifiers_with_the_kernel_s_stamp(port):
    unheard = [0x081, 0x0FF, 0x100, 0x180, 0x181, 0x1FF, 0x291, 0x591, 0x5FF]
    wanted = [0x000, 0x080, 0x600, 0x611, 0x701, 0x7FF]
    flagged = [0x80 | 1 << 31, 0x80 | 1 << 30, 0x80 | 1 << 29]  # extended, remote, error
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
        read_ns = stamp_ns = 0  # Linux switches stamps on a moment after they are asked for
        while stamp_ns >= read_ns:
            host.sendto(linux_frame(0x080, b"\x01"), (GROUP, PORT))
            select.select([port], (), ())
            read_ns = time.time_ns()
            ((stamp_ns, _, _),) = port.receive()
        before_ns = time.time_ns()
        for word in (*unheard, *flagged, *wanted):
            host.sendto(linux_frame(word, b"\x01\x11"), (GROUP, PORT))
        host.sendto(b"short", (GROUP, PORT))
    after_ns = time.time_ns()
    frames = heard(port)
    assert [(can_id, data) for _, can_id, data in frames] == [(i, b"\x01\x11") for i in wanted]
    assert all(before_ns <= t_ns < after_ns for t_ns, _, _ in frames)
    assert port.receive_errors <= 1


def test_the_daemon_s_port_gets_every_frame_of_several_batches_in_order():
    end = device_end(fd=True)
    sent = [(0, 0x181 + k % 7, bytes([k]) * (20 if k % 2 else 8), k % 2 == 1) for k in range(70)]
    assert len(sent) > 2 * SLOTS
    config = bus_config(interface="udp_frames", channel=GROUP, port=PORT, fd=True)
    host = open_can(config, MonotonicClock())
    try:
        assert end.send(sent) == 0
        got = []
        while len(got) < len(sent):
            host.drain()
            got += frame_list(host.take()())
        assert [(f.can_id, f.data, f.is_fd) for f in got] == [f[1:] for f in sent]
        host.write(0x080, b"\x07")
        assert [frame[1:] for frame in heard(end)] == [(0x080, b"\x07")]
    finally:
        host.close()
        end.close()


def test_a_classic_bus_sends_and_hears_no_can_fd():
    end = device_end(fd=False)
    try:
        assert end.send([(0, 0x191, bytes(20), True), (0, 0x192, b"\x01", False)]) == 1
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
            host.sendto(linux_frame(0x080, b"\x03", 64, 4), (GROUP, PORT))
            host.sendto(linux_frame(0x080, b"\x04"), (GROUP, PORT))
        assert [frame[1:] for frame in heard(end)] == [(0x080, b"\x04")]
    finally:
        end.close()


def test_other_interfaces_are_refused_by_name():
    with pytest.raises(ValueError, match="interface slcan"):
        FramePort(BusLink(name="arm", interface="slcan", channel="/dev/null"))
