"""The batch receiver on UDP sockets, which know the same stamps and drop counter as CAN's."""

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


def test_batches_keep_order_lengths_and_bytes(pair, monkeypatch):
    monkeypatch.setattr(linux_can, "SLOTS", 100)  # not a multiple of a system call's
    sender, link = pair
    linux_can.prepare(link, 1 << 20)
    receiver = linux_can.Receiver(link)
    assert len(receive(receiver).lengths) == 0
    count = 2 * linux_can.SLOTS + 10
    sent = [bytes([i % 256]) * (16 if i % 3 else 72) for i in range(count)]
    before_ns = time.time_ns()  # the clock of the stamps
    for data in sent:
        sender.send(data)
    got = [receive(receiver) for _ in range(4)]
    after_ns = time.time_ns()  # a busy kernel stamps a datagram some time after it was sent
    assert [len(batch.lengths) for batch in got] == [linux_can.SLOTS, linux_can.SLOTS, 10, 0]
    assert [data for batch in got for data in datagrams(batch)] == sent
    stamps = [stamp for batch in got for stamp in batch.realtime_ns.tolist()]
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


def receive(receiver):
    receiver.drain()
    return receiver.read()


def drain(receiver):
    frames = []
    while len((batch := receive(receiver)).lengths):
        frames += datagrams(batch)
    return frames


def datagrams(batch):
    lengths = batch.lengths.tolist()
    return [row[:n].tobytes() for row, n in zip(batch.data, lengths, strict=True)]


def test_a_batch_stays_as_it_is_when_the_next_is_received(pair):
    sender, link = pair
    linux_can.prepare(link, 1 << 20)
    receiver = linux_can.Receiver(link)
    sender.send(b"a" * 16)
    first = receive(receiver)
    kept = datagrams(first), first.realtime_ns.copy()
    sender.send(b"b" * 72)
    second = receive(receiver)
    assert datagrams(second) == [b"b" * 72]
    assert datagrams(first) == kept[0] == [b"a" * 16]
    assert first.realtime_ns.tolist() == kept[1].tolist()
    assert second.realtime_ns[0] > first.realtime_ns[0] > 0


def test_what_the_kernel_does_not_stamp_is_told(pair):
    sender, link = pair
    receiver = linux_can.Receiver(link)  # nothing asked for
    sender.send(bytes(16))
    assert receive(receiver).realtime_ns.tolist() == [0]


def test_a_frame_is_laid_out_as_the_kernel_has_it():
    assert linux_can.pack_classic(0x191, b"\x01\x02") == bytes.fromhex(
        "91010000 02000000 0102000000000000"
    )
