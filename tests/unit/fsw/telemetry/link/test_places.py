"""Who has a place on the link: idle connections lock nobody out who commands."""

import socket

import pytest

from fsw.config import TelemetryConfig
from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.packets import telecommand_packet
from fsw.telemetry.link.places import MAX_TRIALS, TRIAL_NS
from fsw.telemetry.link.server import LinkServer
from fsw.telemetry.link.uplink import ClearUplink, LookUplink, Uplink

PING = telecommand_packet(DICTIONARY.telecommand("PING"), {}, 1)
SECOND = 10**9
PLACES = 4


class Doors:
    """A server with time by hand, and its clients."""

    def __init__(self, **settings) -> None:
        self.events: list[tuple[str, str]] = []
        config = TelemetryConfig(port=0, queue_bytes=65536, max_clients=PLACES, **settings)
        self.server = LinkServer(
            config,
            self._uplink,
            lambda code, text: self.events.append((code, text)),
            notice=lambda reason: f"<{reason}>".encode(),
        )
        self.now_ns = 0
        self.sockets: list[socket.socket] = []

    @staticmethod
    def _uplink(may_command: bool) -> Uplink:
        return ClearUplink() if may_command else LookUplink()

    def connect(self, *, port: int = 0, buffer: int = 0) -> socket.socket:
        client = socket.socket()
        if buffer:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        seen = len(self.events)
        client.connect(("127.0.0.1", port or self.server.port))
        client.settimeout(10.0)
        self.sockets.append(client)
        while len(self.events) == seen:  # opened, or refused
            self.server.serve(self.now_ns)
        return client

    def told(self, code: str) -> list[str]:
        return [text for name, text in self.events if name == code]

    def commands(self, client: socket.socket) -> bool:
        """Whether a client's telecommand comes through."""
        client.sendall(PING)
        name = f":{client.getsockname()[1]}:"
        while True:  # one of both comes, however busy the machine
            self.server.serve(self.now_ns)
            if (item := self.server.next_item()) is not None:
                return item.packet == PING and item.error is None
            if any(name in text for text in self.told("LINK_REFUSED")):
                return False

    def wait(self, seconds: float) -> None:
        self.now_ns += round(seconds * SECOND)
        self.server.serve(self.now_ns)

    def close(self) -> None:
        for client in self.sockets:
            client.close()
        self.server.close()


@pytest.fixture
def doors():
    doors = Doors()
    yield doors
    doors.close()


def test_idle_connections_lock_no_operator_out(doors: Doors):
    for _ in range(PLACES):
        doors.connect()
    for _ in range(3):  # one after the other, as `ground tc` does
        operator = doors.connect()
        assert doors.commands(operator)
        doors.wait(2.0 * TRIAL_NS / SECOND)
        assert doors.commands(operator), "the place lasts"
        operator.close()
        doors.wait(0.1)
    assert doors.told("LINK_REFUSED") == []


def test_a_second_operator_takes_the_place_of_the_oldest_who_only_looks(doors: Doors):
    idle = [doors.connect() for _ in range(PLACES)]
    assert doors.commands(doors.connect())
    doors.wait(0.1)
    assert doors.commands(doors.connect())
    assert "given to a client that commands" in idle[0].recv(1000).decode()
    assert idle[0].recv(1000) == b""
    assert doors.server.clients == PLACES + 1


def test_who_sends_no_telecommand_in_a_full_house_goes_with_the_reason(doors: Doors):
    for _ in range(PLACES):
        doors.connect()
    late = doors.connect()
    doors.wait(TRIAL_NS / SECOND - 0.1)
    assert doors.server.clients == PLACES + 1
    doors.wait(0.1)
    assert "4 are connected" in late.recv(1000).decode()
    assert late.recv(1000) == b""
    assert len(doors.told("LINK_REFUSED")) == 1


def test_a_flood_of_newcomers_is_bounded_and_the_operator_still_comes_through(doors: Doors):
    for _ in range(PLACES + MAX_TRIALS + 20):
        doors.connect()
        assert doors.server.clients <= PLACES + MAX_TRIALS
    assert len(doors.told("LINK_REFUSED")) == 20
    assert doors.commands(doors.connect())


def test_places_of_those_who_command_are_taken_from_nobody(doors: Doors):
    operators = [doors.connect() for _ in range(PLACES)]
    assert all(doors.commands(operator) for operator in operators)
    assert doors.commands(doors.connect())
    late = doors.connect()
    doors.commands(late)
    assert "clients that command are connected" in late.recv(1000).decode()
    assert all(doors.commands(operator) for operator in operators)


def test_garbage_gives_no_place(doors: Doors):
    for _ in range(PLACES):
        doors.connect()
    late = doors.connect()
    late.sendall(b"\x00rubbish" * 20 + PING[:-1] + bytes((PING[-1] ^ 1,)))
    doors.wait(TRIAL_NS / SECOND)
    assert doors.server.clients == PLACES


def test_who_reads_nothing_for_too_long_goes(doors: Doors):
    doors.close()
    doors = Doors(idle_timeout_s=30.0)
    stuck, reads = doors.connect(buffer=4096), doors.connect()
    reads.setblocking(False)
    while not doors.server.counters.tm_dropped:
        doors.server.send(bytes(1000))
        doors.server.flush()
        reads.recv(1 << 20)
    doors.wait(29.0)
    doors.server.flush()
    assert doors.server.clients == 2
    doors.wait(1.1)
    assert doors.server.clients == 1
    assert ["read nothing for 30 s" in text for text in doors.told("LINK_REFUSED")] == [True]
    assert stuck.recv(1), "what the system had taken is still there"
    doors.wait(1000.0)
    assert doors.server.clients == 1, "nothing waits for who keeps up"
    doors.close()


def test_on_the_port_to_look_every_telecommand_is_refused():
    doors = Doors(look_port=0)
    viewer = doors.connect(port=doors.server.look_port)
    doors.server.send(b"telemetry")
    doors.server.flush()
    assert viewer.recv(100) == b"telemetry"
    viewer.sendall(PING)
    items = []
    while not items:
        doors.server.serve(0)
        items = list(iter(doors.server.next_item, None))
    assert [(item.packet, item.error) for item in items] == [(PING, Error.NOT_AUTHORISED)]
    for _ in range(PLACES - 1):
        doors.connect(port=doors.server.look_port)
    late = doors.connect(port=doors.server.look_port)
    assert "4 are connected" in late.recv(1000).decode()
    assert doors.commands(doors.connect()), "viewers take no place of the other port"
    doors.close()
