import errno
import os
import socket
import struct

import can
import msgpack
import pytest

from fsw.clock import MonotonicClock
from fsw.drivers.ports.can_bus import CanPort, SocketPort, open_can
from fsw.drivers.ports.linux_can import pack_classic
from fsw.drivers.wire import CanFrame, FrameArray, FramePort, frame_list, unpack_frame
from fsw.errors import PortError
from tests.support.driver_configs import bus_config
from tests.support.kernel_stamps import WAITING_ID, wait_for_kernel_stamps


def taken(port: FramePort) -> list[CanFrame]:
    port.drain()
    return frame_list(port.take()())


def test_frames_pass_both_ways_on_a_virtual_bus() -> None:
    port = open_can(bus_config(channel="drivers-test"), MonotonicClock())
    with can.Bus(interface="virtual", channel="drivers-test") as other:
        sent = port.write(0x080, b"\x07")
        message = other.recv(timeout=1.0)
        assert message is not None
        assert (message.arbitration_id, bytes(message.data)) == (0x080, b"\x07")
        assert not message.is_extended_id
        assert (sent.can_id, sent.data) == (0x080, b"\x07")
        for k in range(3):
            other.send(can.Message(arbitration_id=0x191, data=bytes([k]), is_extended_id=False))
        other.send(can.Message(arbitration_id=0x191, is_remote_frame=True, is_extended_id=True))
        frames = taken(port)
    assert [f.data for f in frames] == [b"\0", b"\1", b"\2", b""]
    assert (frames[3].is_remote, frames[3].is_extended) == (True, True)
    assert sent.t_ns <= frames[0].t_ns <= frames[3].t_ns
    assert taken(port) == []
    assert port.wake_fds() == ()
    port.close()


@pytest.mark.parametrize("interface", ["udp_multicast", "udp_frames"])
def test_multicast_carries_frames_between_ports(interface: str) -> None:
    config = bus_config(interface=interface, channel="239.74.163.9", port=43997)
    clock = MonotonicClock()
    first, second = open_can(config, clock), open_can(config, clock)
    try:
        wait_for_kernel_stamps(first, clock)
        before_ns = clock.now_ns()
        sent = first.write(0x191, bytes(range(8)))
        after_ns = clock.now_ns()
        clock.sleep_until_ns(after_ns + 20_000_000)
        frames = [f for _ in range(2000) for f in taken(second) if f.can_id != WAITING_ID]
        assert [(f.can_id, f.data, f.is_extended) for f in frames] == [
            (0x191, bytes(range(8)), False)
        ]
        # the sender gets it back; both have the kernel's stamp of its sending, not of the reading
        own = [f for _ in range(200) for f in taken(first) if f.can_id != WAITING_ID]
        assert [(f.can_id, f.data) for f in own] == [(sent.can_id, sent.data)]
        for frame in (*frames, *own):
            assert before_ns - 100_000 <= frame.t_ns <= after_ns + 100_000
    finally:
        first.close()
        second.close()


@pytest.mark.parametrize("interface", ["udp_multicast", "udp_frames"])
def test_frames_that_were_read_stay_when_the_next_come(interface: str) -> None:
    config = bus_config(interface=interface, channel="239.74.163.9", port=43996)
    clock = MonotonicClock()
    port = open_can(config, clock)
    try:
        wait_for_kernel_stamps(port, clock)
        port.write(0x191, bytes(range(8)))
        first = read_one(port, 0x191)
        kept = first.copy()
        port.write(0x192, bytes(range(8, 16)))
        second = read_one(port, 0x192)
        assert first.tobytes() == kept.tobytes()
        assert frame_list(first)[0].data == bytes(range(8))
        assert frame_list(second)[0].data == bytes(range(8, 16))
    finally:
        port.close()


def read_one(port: FramePort, can_id: int) -> FrameArray:
    while True:
        port.drain()
        frames = port.take()()
        if (frames["word"] == can_id).any():
            return frames


@pytest.mark.parametrize("interface", ["no_such_interface", "socketcan"])
def test_a_bus_that_cannot_be_opened_is_named(interface: str) -> None:
    config = bus_config(interface=interface, channel="none0")
    with pytest.raises(PortError, match=rf"buses\.arm \({interface} none0\)"):
        open_can(config, MonotonicClock())


def test_linux_frames_are_read_field_by_field() -> None:
    classic = struct.pack("=IB3x8s", 0x191 | socket.CAN_RTR_FLAG, 2, b"ab")
    frame = unpack_frame(5, classic)
    assert frame is not None
    assert (frame.t_ns, frame.can_id, frame.data) == (5, 0x191, b"ab")
    assert (frame.is_remote, frame.is_fd, frame.is_extended, frame.is_error) == (True,) + 3 * (
        False,
    )
    fd = struct.pack("=IBB2x64s", 0x18FF0001 | socket.CAN_EFF_FLAG, 20, 0x01, bytes(range(64)))
    frame = unpack_frame(6, fd)
    assert frame is not None
    assert (frame.can_id, frame.data) == (0x18FF0001, bytes(range(20)))
    assert (frame.is_fd, frame.is_extended, frame.bitrate_switch) == (True, True, True)


def test_the_classes_of_an_error_frame_are_read_whole() -> None:
    classes = 0x1000_0204
    error = struct.pack("=IB3x8s", classes | socket.CAN_ERR_FLAG, 8, bytes(8))
    frame = unpack_frame(7, error)
    assert frame is not None
    assert (frame.is_error, frame.is_extended, frame.can_id) == (True, False, classes)


def test_a_broken_bus_raises_a_port_error() -> None:
    class Broken(can.BusABC):
        channel_info = "broken"

        def __init__(self) -> None:
            super().__init__(channel="broken")

        def send(self, *_: object, **__: object) -> None:
            raise can.CanOperationError("bus off")

        def _recv_internal(self, *_: object, **__: object) -> tuple[can.Message | None, bool]:
            raise can.CanOperationError("bus off")

    port = CanPort(Broken(), MonotonicClock(), "buses.arm (x y)")
    with pytest.raises(PortError, match="bus off"):
        port.drain()
    with pytest.raises(PortError, match="bus off"):
        port.write(1, b"")
    port.close()


def test_frames_that_came_before_a_send_failed_are_kept() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
            peer.bind(("127.0.0.1", 0))
            link.connect(peer.getsockname())
            port = SocketPort(link, MonotonicClock(), "buses.arm (can0)", link.close)
            for number in range(3):
                peer.sendto(pack_classic(0x191 + number, b"ab"), link.getsockname())
        port.write(0x80, b"")  # nobody has the port any more: the kernel's answer fails the next
        with pytest.raises(PortError, match="cannot be written"):
            port.write(0x80, b"")
        assert [frame.can_id for frame in frame_list(port.take()())] == [0x191, 0x192, 0x193]


def test_datagrams_that_are_no_frames_are_left_out_and_the_others_are_kept() -> None:
    config = bus_config(interface="udp_multicast", channel="239.74.163.9", port=43998)
    good = {
        "arbitration_id": 0x191, "data": b"ab", "is_extended_id": False, "is_remote_frame": False,
        "is_error_frame": False, "is_fd": False, "bitrate_switch": False,
    }  # fmt: skip
    bad = [
        {"arbitration_id": 0x1191}, {"arbitration_id": -1}, {"arbitration_id": "x"},
        {"arbitration_id": 1 << 40}, {"data": bytes(9)}, {"data": "text"}, {"data": 5},
        {"is_fd": True, "data": bytes(65)}, {"bitrate_switch": True, "data": bytes(20)},
    ]  # fmt: skip
    datagrams = [msgpack.packb(good | change) for change in bad]
    datagrams += [b"", b"\xc1", b"\x93\x01\x02", msgpack.packb([good]), msgpack.packb({})]
    port = open_can(config, MonotonicClock())
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for datagram in (*datagrams, msgpack.packb(good)):
                sender.sendto(datagram, ("239.74.163.9", 43998))
        frames: list[CanFrame] = []
        while not frames:
            frames += taken(port)
    finally:
        port.close()
    assert [(f.can_id, f.data) for f in frames] == [(0x191, b"ab")]


def test_a_kernel_without_can_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(**_options: object) -> None:
        raise OSError(errno.EAFNOSUPPORT, os.strerror(errno.EAFNOSUPPORT))

    monkeypatch.setattr(can, "Bus", refused)
    bus = bus_config(interface="socketcan", channel="can0")
    with pytest.raises(PortError, match=r"buses.arm .*: this kernel has no CAN .*modprobe can_raw"):
        open_can(bus, MonotonicClock())
