"""The TCP port: slow clients, garbage, resynchronisation, rejection reports; the UDP push."""

import binascii
import socket
import struct
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from fsw.config import TelemetryConfig
from fsw.errors import PortError
from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.packets import telecommand_packet, uplink_file_packet
from fsw.telemetry.link.server import LinkServer
from fsw.telemetry.link.splitter import PATIENCE_NS
from fsw.telemetry.link.uplink import ClearUplink

PING = telecommand_packet(DICTIONARY.telecommand("PING"), {}, 1)
QUEUE = 65536


class Link:
    """A server and what it reported."""

    def __init__(self, **config) -> None:
        self.told: list[str] = []
        settings = TelemetryConfig(port=0, queue_bytes=QUEUE, **config)
        self.server = LinkServer(settings, lambda _: ClearUplink(), self._report)
        self.clients: list[socket.socket] = []

    def _report(self, code: str, _text: str) -> None:
        self.told.append(code)

    def connect(self, *, buffer: int = 0) -> socket.socket:
        client = socket.socket()
        if buffer:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        client.connect(("127.0.0.1", self.server.port))
        client.settimeout(10.0)
        self.clients.append(client)
        before = self.server.clients
        while self.server.clients == before:
            self.server.serve(0)
        return client

    def take(self, count: int) -> list:
        """Serve until so many items came."""
        found = []
        while len(found) < count:
            found += self.look(0)
        return found

    def look(self, now_ns: int) -> list:
        """Serve once; return what came up."""
        self.server.serve(now_ns)
        return list(iter(self.server.next_item, None))

    def close(self) -> None:
        for client in self.clients:
            client.close()
        self.server.close()


@pytest.fixture
def link():
    link = Link()
    yield link
    link.close()


def test_packets_go_both_ways(link: Link):
    client = link.connect()
    client.sendall(PING + PING)
    assert [item.packet for item in link.take(2)] == [PING, PING]
    link.server.send(b"abc")
    link.server.send(b"defg")
    link.server.flush()
    assert client.recv(100) == b"abcdefg"
    assert link.server.counters.tm_packets == 2


def test_a_stuck_client_costs_its_own_packets_whole_and_nobody_waits(link: Link):
    stuck, good = link.connect(buffer=4096), link.connect()
    packet, sent, received = bytes(1000), 0, b""
    while link.server.counters.tm_dropped < 200:
        link.server.send(packet)
        sent += 1
        link.server.flush()
        received += good.recv(1 << 20)
        assert sent < 100_000
    good.setblocking(False)
    while len(received) < 1000 * sent:
        link.server.flush()
        received += good.recv(1 << 20)
    dropped = link.server.counters.tm_dropped
    assert len(received) == 1000 * sent
    taken = 0
    stuck.settimeout(0.5)
    while taken < 1000 * (sent - dropped):
        link.server.flush()
        taken += len(stuck.recv(1 << 20))
    link.server.flush()
    with pytest.raises(TimeoutError):
        stuck.recv(1)  # the stream holds whole packets only: every byte is accounted for
    assert link.told.count("LINK_DROPS") == link.told.count("LINK_CAUGHT_UP") == 1


def test_a_client_has_caught_up_though_every_look_finds_a_new_packet(link: Link):
    client = link.connect(buffer=4096)
    packet = bytes(1000)
    while not link.server.counters.tm_dropped:
        link.server.send(packet)
        link.server.flush()
    client.settimeout(0.02)
    for _ in range(500):  # as a daemon goes on: records, then what has come up, then what goes down
        link.server.send(packet)
        link.server.serve(0)
        link.server.flush()
        with suppress(TimeoutError):
            client.recv(1 << 20)
        if "LINK_CAUGHT_UP" in link.told:
            break
    assert link.told.count("LINK_DROPS") == link.told.count("LINK_CAUGHT_UP") == 1


def test_a_client_that_goes_is_told_and_the_others_stay(link: Link):
    first, second = link.connect(), link.connect()
    first.close()
    while link.server.clients > 1:
        link.server.serve(0)
    link.server.send(b"x")
    link.server.flush()
    assert second.recv(10) == b"x"
    assert link.told.count("LINK_CLOSED") == 1


def test_garbage_is_counted_told_and_left_behind(link: Link):
    client = link.connect()
    garbage = b"\x00garbage\xff" * 11
    client.sendall(garbage + PING)
    assert [item.packet for item in link.take(1)] == [PING]
    link.server.serve(0)
    assert link.server.counters.tc_garbage_bytes == len(garbage)
    assert link.server.counters.tc_resyncs == 1
    assert "TC_GARBAGE" in link.told


def test_a_port_in_use_is_refused(link: Link):
    with pytest.raises(PortError, match="in use"):
        LinkServer(TelemetryConfig(port=link.server.port), lambda _: ClearUplink(), lambda *_: None)


def test_udp_carries_one_packet_per_datagram():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
        ear.bind(("127.0.0.1", 0))
        ear.settimeout(10.0)
        link = Link(udp={"port": ear.getsockname()[1]})
        link.server.send(b"one")
        link.server.send(b"two")
        assert (ear.recv(100), ear.recv(100)) == (b"one", b"two")
        assert link.server.counters.udp_packets == 2
        link.close()


def test_without_authentication_only_loopback_is_bound():
    with pytest.raises(ValidationError, match="tc_security"):
        TelemetryConfig(host="0.0.0.0")
    with pytest.raises(ValidationError, match="numeric"):
        TelemetryConfig(host="localhost")
    with pytest.raises(ValidationError, match="sdls"):
        TelemetryConfig(tc_security="sdls")
    assert TelemetryConfig(host="::1").host == "::1"


class TestSplitter:
    def test_every_cut_of_the_stream_gives_the_same_packets(self):
        stream = b"\x17" + PING + uplink_file_packet(b"unit", 3) + b"\x00\x01" + PING
        for cut in range(len(stream)):
            uplink = ClearUplink()
            found = uplink.feed(stream[:cut], 0) + uplink.feed(stream[cut:], 0)
            assert [item.packet for item in found] == [PING, uplink_file_packet(b"unit", 3), PING]
            assert uplink.skipped_bytes == 3

    def test_a_known_packet_with_a_wrong_crc_is_told(self):
        uplink = ClearUplink()
        bad = PING[:-1] + bytes((PING[-1] ^ 1,))
        found = uplink.feed(bad + PING, 0)
        assert [item.error for item in found] == [Error.BAD_CRC, None]
        assert uplink.skipped_bytes == len(bad)

    def test_what_never_gets_its_rest_does_not_hold_up_the_next(self):
        uplink = ClearUplink()
        head = PING[:4] + b"\x00\x40" + b"\x2f"  # of a longer packet
        assert uplink.feed(head + PING, 0) == []
        assert [item.packet for item in uplink.expire(PATIENCE_NS)] == [PING]
        assert uplink.skipped_bytes == 7

    def test_another_applications_packet_is_passed_on_to_be_refused(self):
        body = b"\x18\x65" + PING[2:-2]
        other = body + struct.pack(">H", binascii.crc_hqx(body, 0xFFFF))
        assert [item.packet for item in ClearUplink().feed(other, 0)] == [other]

    @given(st.lists(st.binary(max_size=40), max_size=8))
    def test_no_byte_is_lost(self, chunks):
        uplink = ClearUplink()
        found = [item for chunk in chunks for item in uplink.feed(chunk, 0)]
        used = sum(len(item.packet) for item in found if item.error is None)
        assert used + uplink.skipped_bytes + uplink.pending_bytes == sum(map(len, chunks))
        assert uplink.pending_bytes < 2048
