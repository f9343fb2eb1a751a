"""The daemon's CAN port on a real SocketCAN link, python-can at the other end."""

import gc
import os
import subprocess
import time

import can
import pytest

from fsw.clock import MonotonicClock
from fsw.drivers.ports.can_bus import RECEIVE_BUFFER_BYTES, SocketPort, open_can
from fsw.drivers.wire import frame_list
from fsw.errors import PortError
from tests.support.driver_configs import bus_config
from tests.support.kernel_stamps import wait_for_kernel_stamps

CLOCK = MonotonicClock()


def opened(channel="vcan0", *, fd=False):
    port = open_can(bus_config(interface="socketcan", channel=channel, fd=fd), CLOCK)
    assert isinstance(port, SocketPort)
    return port


@pytest.fixture
def port():
    port = opened()
    wait_for_kernel_stamps(port, CLOCK)
    yield port
    port.close()


@pytest.fixture
def other():
    with can.Bus(interface="socketcan", channel="vcan0", fd=True) as bus:
        yield bus


def message(number, *, can_id=0x191, fd=False, **more):
    data = number.to_bytes(8, "little").ljust(20 if fd else 8, b"\xa5")
    return can.Message(
        arbitration_id=can_id,
        data=data,
        is_fd=fd,
        bitrate_switch=fd,
        **{"is_extended_id": False} | more,
    )


def taken(port):
    port.drain()
    return frame_list(port.take()())


def received(port, count):
    """Return so many frames; the kernel may deliver a little after it took them."""
    frames = []
    deadline_ns = CLOCK.now_ns() + 20_000_000_000
    while len(frames) < count and CLOCK.now_ns() < deadline_ns:
        frames += taken(port)
    return frames


def ip(*words):
    subprocess.run(["ip", "link", *words], check=True)


def test_classic_frames_pass_both_ways_and_carry_kernel_stamps(port, other):
    sent = port.write(0x080, b"\x07")
    got = other.recv(10.0)
    assert (got.arbitration_id, bytes(got.data), got.is_fd) == (0x080, b"\x07", False)
    (own,) = received(port, 1)  # as it was on the bus
    assert (own.can_id, own.data) == (0x080, b"\x07")
    assert own.t_ns <= sent.t_ns + 100_000
    before_ns = CLOCK.now_ns()
    for k in range(200):  # more than three batches
        other.send(message(k))
    after_ns = CLOCK.now_ns()
    other.send(message(0, can_id=0x18FF0001, is_extended_id=True))
    other.send(can.Message(arbitration_id=0x191, is_remote_frame=True, is_extended_id=False))
    frames = received(port, 202)
    assert [int.from_bytes(f.data, "little") for f in frames[:200]] == list(range(200))
    assert all(f.can_id == 0x191 and not f.is_extended and not f.is_fd for f in frames[:200])
    assert frames[200].is_extended
    assert frames[200].can_id == 0x18FF0001
    assert frames[201].is_remote
    stamps = [f.t_ns for f in frames[:200]]
    assert stamps == sorted(stamps)
    # stamped when sent, not when read; clocks are compared once per batch, within 0.1 ms
    assert before_ns - 100_000 <= stamps[0] <= stamps[-1] <= after_ns + 100_000
    assert sent.t_ns <= stamps[0]
    assert taken(port) == []
    assert port.take_dropped() == 0


def test_fd_frames_keep_length_and_bit_rate_switch(other):
    port = opened(fd=True)
    try:
        for k in range(100):
            other.send(message(k, fd=k % 2 == 0))
        frames = received(port, 100)
    finally:
        port.close()
    assert [int.from_bytes(f.data[:8], "little") for f in frames] == list(range(100))
    assert [(len(f.data), f.is_fd, f.bitrate_switch) for f in frames] == [
        (20, True, True),
        (8, False, False),
    ] * 50


def test_a_classic_port_does_not_see_fd_frames(port, other):
    other.send(message(1, fd=True))
    other.send(message(2))
    assert [f.data[0] for f in received(port, 1)] == [2]


def test_the_receive_buffer_is_as_large_as_asked(port):
    assert port.buffer_bytes == 2 * RECEIVE_BUFFER_BYTES  # the kernel doubles


def test_every_frame_lost_in_the_receive_buffer_is_counted(port, other):
    burst = 16_000  # the buffer holds some 10 900
    for k in range(burst):
        other.send(message(k))
    kept = taken(port)
    numbers = [int.from_bytes(f.data, "little") for f in kept]
    assert numbers == list(range(len(kept)))  # the oldest are kept, none doubled
    assert 0 < len(kept) < burst
    more, after = 0, []
    while not after or after[-1] < burst:  # frames that find room again
        other.send(message(burst + more))
        more += 1
        after += [int.from_bytes(f.data, "little") for f in received(port, 1)]
    assert port.take_dropped() == burst + more - len(kept) - len(after)
    assert port.take_dropped() == 0


def test_a_link_that_goes_down_is_a_lost_port_and_opens_again_when_up():
    port = opened("vcan1")
    ip("set", "vcan1", "down")
    try:
        with pytest.raises(PortError, match=r"buses\.arm .*Network is down"):
            port.drain()
        with pytest.raises(PortError, match="Network is down"):
            port.write(0x080, b"\x01")
        port.close()
        with pytest.raises(PortError, match="cannot be opened: Network is down"):
            opened("vcan1")
    finally:
        ip("set", "vcan1", "up")
    port = opened("vcan1")
    with can.Bus(interface="socketcan", channel="vcan1") as peer:
        peer.send(message(1))
        assert [f.data[0] for f in received(port, 1)] == [1]
    port.close()


def test_frames_received_before_the_link_went_down_are_there_after_the_error():
    port = opened("vcan1")
    with (
        can.Bus(interface="socketcan", channel="vcan1") as peer,
        can.Bus(interface="socketcan", channel="vcan1") as witness,
    ):
        peer.send(message(1))
        assert witness.recv(10.0) is not None
        ip("set", "vcan1", "down")
    try:
        with pytest.raises(PortError, match="Network is down"):
            port.drain()
        assert [f.data[0] for f in frame_list(port.take()())] == [1]
    finally:
        ip("set", "vcan1", "up")
        port.close()


@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_a_link_that_does_not_exist_is_named():
    with pytest.raises(PortError, match=r"buses\.arm \(socketcan vcan7\)") as caught:
        opened("vcan7")
    del caught
    gc.collect()  # python-can leaves the socket it could not bind to the collector


def test_error_frames_are_read_beside_data(port, other):
    other.send(
        can.Message(
            arbitration_id=0x204, data=bytes.fromhex("0020000000008000"), is_error_frame=True
        )
    )
    other.send(message(1))
    error, data = received(port, 2)
    assert error.is_error
    assert (error.can_id, error.data.hex()) == (0x204, "0020000000008000")
    assert not data.is_error


@pytest.mark.skipif(os.environ.get("HIL_VCAN") == "kernel", reason="it is this machine's clock")
def test_a_clock_set_back_moves_no_stamp_out_of_its_read(port, other):
    taken(port)
    before_ns = CLOCK.now_ns()
    now_s = time.clock_gettime(time.CLOCK_REALTIME)
    try:
        other.send(message(1))
        time.clock_settime(time.CLOCK_REALTIME, now_s - 3600.0)
        other.send(message(2))
        frames = received(port, 2)
        after_ns = CLOCK.now_ns()
    finally:
        time.clock_settime(time.CLOCK_REALTIME, now_s)
    assert before_ns - 1_000_000 <= frames[0].t_ns <= after_ns
    assert before_ns - 1_000_000 <= frames[1].t_ns <= after_ns
