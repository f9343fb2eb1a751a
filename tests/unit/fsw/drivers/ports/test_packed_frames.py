"""Packed frames are read as python-can itself reads them, whatever stands beside them."""

import can
import msgpack
import numpy as np
from can.interfaces.udp_multicast.utils import pack_message, unpack_message
from hypothesis import example, given, settings
from hypothesis import strategies as st

from fsw.drivers.ports.linux_can import Received
from fsw.drivers.ports.packed_frames import PACKED_BYTES, Unpacker, packed
from fsw.drivers.wire import frame_list

FD_LENGTHS = [0, 1, 7, 8, 12, 20, 48, 64]
NODES = [0x191, 0x192, 0x193]


@st.composite
def messages(draw: st.DrawFn) -> bytes:
    """Return a plain sample, most of the time, or any other message."""
    channel = draw(st.sampled_from([None, "239.74.163.2", "data\xc4\x08arbitration_id\xcd"]))
    if draw(st.integers(0, 3)):
        return bytes(
            pack_message(
                can.Message(
                    timestamp=draw(st.floats(0, 1e9)),
                    arbitration_id=draw(st.sampled_from([*NODES, 0x80])),
                    data=draw(st.binary(min_size=8, max_size=8)),
                    is_extended_id=False,
                    channel=channel,
                )
            )
        )
    is_fd, is_extended = draw(st.booleans()), draw(st.booleans())
    length = draw(st.sampled_from(FD_LENGTHS if is_fd else range(9)))
    return bytes(
        pack_message(
            can.Message(
                timestamp=draw(st.sampled_from([0.0, 1.5])),
                arbitration_id=draw(st.integers(0, 0x1FFFFFFF if is_extended else 0x7FF)),
                data=draw(st.binary(min_size=length, max_size=length)),
                is_extended_id=is_extended,
                is_fd=is_fd,
                bitrate_switch=is_fd and draw(st.booleans()),
                is_remote_frame=not is_fd and not length and draw(st.booleans()),
                channel=channel,
            )
        )
    )


def changed(draw_from: bytes, place: int, value: int) -> bytes:
    at = place % len(draw_from)
    return draw_from[:at] + bytes([value]) + draw_from[at + 1 :]


datagrams = messages() | st.builds(changed, messages(), st.integers(0, 300), st.integers(0, 255))


def batch_of(items: list[bytes]) -> Received:
    data = np.full((len(items), PACKED_BYTES), 0xAA, np.uint8)  # what a slot held before
    for row, item in zip(data, items, strict=True):
        row[: len(item)] = np.frombuffer(item, np.uint8)
    lengths = np.array([len(item) for item in items], np.uint32)
    return Received(data, lengths, np.zeros(len(items), np.int64))


def read_alone(item: bytes) -> tuple[object, ...] | None:
    """Return what python-can reads; None where that is no frame it would have sent."""
    try:
        raw = msgpack.unpackb(item)
        message = unpack_message(item, replace={}, check=True)
        if msgpack.packb(raw) != item or any(type(raw[key]) is not bool for key in FLAGS):
            return None
    except Exception:  # noqa: BLE001
        return None
    return (
        message.arbitration_id,
        bytes(message.data),
        message.is_fd,
        message.is_extended_id,
        message.is_remote_frame,
        message.bitrate_switch,
    )


FLAGS = ("is_extended_id", "is_remote_frame", "is_error_frame", "is_fd", "bitrate_switch")


@settings(max_examples=200, deadline=None)
@given(st.lists(st.lists(datagrams, min_size=1, max_size=12), min_size=1, max_size=3))
@example([[packed(0x191, bytes(8)), packed(0x7FF, bytes(8)), packed(0x80, b"\x01")]])
def test_frames_of_a_batch_are_those_that_python_can_reads(batches: list[list[bytes]]) -> None:
    unpacker = Unpacker()
    for items in batches:
        stamps_ns = np.arange(len(items)) + 1
        found = {f.t_ns: f for f in frame_list(unpacker.frames(batch_of(items), stamps_ns))}
        assert list(found) == sorted(found)
        for t_ns, item in zip(stamps_ns.tolist(), items, strict=True):
            wanted = read_alone(item)
            if wanted is None or "error_frame" not in str(msgpack.unpackb(item)):
                continue  # no frame; some readers are more tolerant than others
            if msgpack.unpackb(item)["is_error_frame"]:
                continue
            frame = found[t_ns]
            assert wanted == (
                frame.can_id,
                frame.data,
                frame.is_fd,
                frame.is_extended,
                frame.is_remote,
                frame.bitrate_switch,
            )


def test_most_frames_are_read_without_msgpack(monkeypatch) -> None:
    unpacker = Unpacker()
    unpacker.frames(batch_of([packed(0x191, bytes(8))]), np.array([1]))
    monkeypatch.setattr("fsw.drivers.ports.packed_frames.msgpack.unpackb", None)
    items = [packed(node, bytes([node & 0xFF] * 8)) for node in NODES]
    found = frame_list(unpacker.frames(batch_of(items), np.arange(3)))
    assert [frame.can_id for frame in found] == NODES
    assert [frame.data for frame in found] == [bytes([node & 0xFF] * 8) for node in NODES]


def test_a_datagram_of_a_known_size_that_differs_elsewhere_is_read_by_itself() -> None:
    unpacker = Unpacker()
    plain = packed(0x191, bytes(8))
    remote = plain.replace(b"is_remote_frame\xc2", b"is_remote_frame\xc3")
    junk = bytes(len(plain))
    found = frame_list(unpacker.frames(batch_of([plain, remote, junk, plain]), np.arange(4)))
    assert [(frame.t_ns, frame.is_remote) for frame in found] == [(0, False), (1, True), (3, False)]
