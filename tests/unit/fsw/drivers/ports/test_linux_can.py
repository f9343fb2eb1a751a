"""The batch receiver on UDP sockets, which know the same stamps and drop counter as CAN's."""

from __future__ import annotations

import socket
import time

import pytest

from fsw.drivers.ports import linux_can


@pytest.fixture
def pair():
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
    ):
        receiver.bind(("127.0.0.1", 0))
        sender.connect(receiver.getsockname())
        yield sender, receiver


def test_batches_keep_order_lengths_and_bytes(pair):
    sender, link = pair
    linux_can.prepare(link, 1 << 20)
    receiver = linux_can.Receiver(link)
    assert receiver.receive() == []
    count = 2 * linux_can.BATCH + 10
    sent = [bytes([i % 256]) * (16 if i % 3 else 72) for i in range(count)]
    before_ns = time.time_ns()  # the clock of the stamps
    for data in sent:
        sender.send(data)
    after_ns = time.time_ns()
    got = [receiver.receive() for _ in range(4)]
    assert [len(batch) for batch in got] == [linux_can.BATCH, linux_can.BATCH, 10, 0]
    frames = [frame for batch in got for frame in batch]
    assert [frame.data for frame in frames] == sent
    stamps = [frame.realtime_ns for frame in frames]
    assert stamps == sorted(stamps)
    assert before_ns <= stamps[0] <= stamps[-1] <= after_ns
    assert receiver.dropped == 0


def test_every_frame_the_buffer_had_no_room_for_is_counted_with_the_first_after_it(pair):
    sender, link = pair
    linux_can.prepare(link, 4096)
    receiver = linux_can.Receiver(link)
    lost = 0
    for burst in (200, 3, 200):  # the middle one finds room
        for _ in range(burst):
            sender.send(bytes(16))
        kept = len(drain(receiver))
        assert receiver.dropped == lost  # not told yet
        lost += burst - kept
        sender.send(bytes(16))
        assert len(drain(receiver)) == 1
        assert receiver.dropped == lost
    assert lost > 100


def drain(receiver):
    frames = []
    while batch := receiver.receive():
        frames += batch
    return frames


def test_a_frame_is_laid_out_as_the_kernel_has_it():
    assert linux_can.pack_classic(0x191, b"\x01\x02") == bytes.fromhex(
        "91010000 02000000 0102000000000000"
    )
