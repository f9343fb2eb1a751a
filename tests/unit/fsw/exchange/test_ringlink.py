"""Messages through a ring: what the other end gets, and what found no room."""

import os

import numpy as np
import pytest

from fsw.config import load
from fsw.drivers.wire import ByteChunk, CanFrame, frame_array, frame_list
from fsw.exchange.ring import RingReader, RingWriter
from fsw.exchange.ringlink import (
    TO_ESTIMATION,
    TO_SERVICE,
    Kind,
    RingSink,
    hand_down,
    handed_down,
    message_of,
)
from fsw.exchange.sinks import BatchEnd, CanTraffic, SerialTraffic
from fsw.messages import Event
from fsw.messages.commands import Command, CommandName
from fsw.messages.findings import Stall
from tests.conftest import ArmProject

FRAMES = frame_array([CanFrame(k, 0x181, bytes(8)) for k in range(10)])
STREAM = [
    CanTraffic("arm", FRAMES),
    SerialTraffic("imu", [ByteChunk(5, b"abc"), ByteChunk(6, b"")]),
    BatchEnd(now_ns=9, lost=("imu",), tick=3, slips=2, stalls=(Stall(1, 2, 1),), over_budget_ns=4),
    Command(name=CommandName.RESET, id=8),
]


def test_the_estimation_gets_the_stream_and_is_called_at_the_end_of_a_batch() -> None:
    ring, wake = RingWriter.create(1 << 16), os.eventfd(0, os.EFD_NONBLOCK)
    sink = RingSink(ring, TO_ESTIMATION, wake)
    for message in [*STREAM, Event(1, "info", "STARTED", "")]:
        sink.put(message)
    assert os.eventfd_read(wake) == 2
    found = [message_of(record) for record in RingReader(os.dup(ring.fd)).read()]
    assert np.array_equal(found[0].frames, FRAMES)
    assert found[1:] == STREAM[1:]
    os.close(wake)


@pytest.mark.parametrize("fd", [(), (1,), (0, 1, 2)])
def test_frames_come_out_of_a_ring_as_they_went_in(fd: tuple[int, ...]) -> None:
    sent = [
        CanFrame(1 << 60, 0x7FF, bytes(range(1, 65 if 0 in fd else 9)), is_fd=0 in fd),
        CanFrame(2, 0x1FFFFFFF, bytes(range(1, 8)), is_extended=True, is_fd=1 in fd),
        CanFrame(3, 0x5, b"", is_remote=2 not in fd, is_fd=2 in fd, bitrate_switch=2 in fd),
    ]
    ring = RingWriter.create(1 << 12)
    RingSink(ring, TO_SERVICE).put(CanTraffic("arm", frame_array(sent)))
    (record,) = RingReader(os.dup(ring.fd)).read()
    found = message_of(record)
    assert isinstance(found, CanTraffic)
    assert (found.bus, frame_list(found.frames)) == ("arm", sent)


def test_the_service_gets_traffic_and_events_and_no_end_of_a_batch() -> None:
    ring = RingWriter.create(1 << 16)
    sink = RingSink(ring, TO_SERVICE)
    for message in [*STREAM, Event(1, "info", "STARTED", "")]:
        sink.put(message)
    sink.close()
    records = list(RingReader(os.dup(ring.fd)).read())
    assert [type(message_of(record)) for record in records[:-1]] == [
        CanTraffic,
        SerialTraffic,
        Event,
    ]
    assert records[-1].kind == Kind.END


def test_what_finds_no_room_is_counted_to_the_frame() -> None:
    ring = RingWriter.create(1024)
    sink = RingSink(ring, TO_ESTIMATION)
    for _ in range(5):
        sink.put(STREAM[0])
        sink.put(STREAM[1])
    found = [message_of(record) for record in RingReader(os.dup(ring.fd)).read()]
    frames = sum(len(m.frames) for m in found if isinstance(m, CanTraffic))
    chunks = sum(len(m.chunks) for m in found if isinstance(m, SerialTraffic))
    assert sink.lost == 5 * (len(FRAMES) + 2) - frames - chunks > 0


def test_processes_that_share_a_descriptor_read_the_configuration_whole(
    arm: ArmProject,
) -> None:
    """Both are started at once: where one has read to is no matter of the other."""
    config = load(arm.write())
    fd = hand_down(config)
    os.lseek(fd, 100, os.SEEK_SET)
    assert handed_down(fd) == config
    assert os.lseek(fd, 0, os.SEEK_CUR) == 100
    os.close(fd)
