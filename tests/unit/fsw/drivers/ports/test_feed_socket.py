"""The socket of a feed: Unix or UDP, one chunk for each datagram."""

import socket
import stat
from pathlib import Path

import pytest

from fsw.clock import MonotonicClock
from fsw.drivers.ports.feed_socket import READ_BYTES, FeedPort, open_feed
from fsw.errors import PortError


def read_all(port: FeedPort, count: int) -> list[bytes]:
    found = []
    while len(found) < count:
        found += port.read()
    assert [chunk.t_ns for chunk in found] == sorted(chunk.t_ns for chunk in found)
    return [chunk.data for chunk in found]


def test_datagrams_of_a_unix_socket_are_whole_and_in_order(tmp_path: Path):
    path = tmp_path / "arm.sock"
    port = open_feed(path, MonotonicClock())
    assert stat.S_IMODE(path.stat().st_mode) == 0o660
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        for data in (b"one", b"", b"x" * 5000):
            sender.sendto(data, str(path))
    assert read_all(port, 3) == [b"one", b"", b"x" * READ_BYTES]
    assert port.read() == []
    port.close()
    assert not path.exists()


def test_datagrams_of_a_udp_socket_are_whole_and_in_order():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        place = probe.getsockname()
    port = open_feed(place, MonotonicClock())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for data in (b"one", b"two", b"x" * 5000):
            sender.sendto(data, place)
        assert read_all(port, 3) == [b"one", b"two", b"x" * READ_BYTES]
    with pytest.raises(PortError, match=f"{place[1]}: cannot be opened: Address already in use$"):
        open_feed(place, MonotonicClock())
    port.close()


def test_the_path_of_a_process_that_has_ended_is_used_again(tmp_path: Path):
    path = tmp_path / "arm.sock"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as left:
        left.bind(str(path))
    port = open_feed(path, MonotonicClock())
    with pytest.raises(
        PortError, match=f"^feed {path}: cannot be opened: another process receives here$"
    ):
        open_feed(path, MonotonicClock())
    port.close()


def test_a_place_that_cannot_be_opened_is_named(tmp_path: Path):
    other = tmp_path / "file"
    other.write_text("kept")
    for path in (other, tmp_path / "none" / "arm.sock"):
        with pytest.raises(PortError, match=str(path)):
            open_feed(path, MonotonicClock())
    assert other.read_text() == "kept"
