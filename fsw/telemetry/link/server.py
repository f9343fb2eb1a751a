"""The link to the ground: one duplex TCP port with raw packets, and an optional UDP push.

Nothing here waits. What a slow client does not read stays in a bounded outbox; what does not fit
there is dropped, whole packets only, and counted. What a client sends stays in its inbox until
`next_item` is called; while that is full, its bytes stay in the system's buffers.
"""

from __future__ import annotations

import selectors
import socket
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from fsw.config.telemetry import TelemetryConfig
from fsw.messages.errors import PortError
from fsw.telemetry.link.splitter import Uplinked
from fsw.telemetry.link.uplink import Uplink
from fsw.telemetry.outbox import Outbox, Priority

READ_BYTES = 16384
INBOX_ITEMS = 256  # of one client; then its bytes are left where they are
SYSTEM_BYTES = 1 << 16  # the system's own buffer: nothing overtakes what waits there
Report = Callable[[str, str], None]  # event code, text


@dataclass(slots=True)
class LinkCounters:
    """What went over the link, of all clients so far."""

    tm_packets: int = 0
    tm_bytes: int = 0
    tm_dropped: int = 0
    tc_bytes: int = 0
    tc_garbage_bytes: int = 0
    tc_resyncs: int = 0
    udp_packets: int = 0
    udp_dropped: int = 0


@dataclass(slots=True)
class _Client:
    connection: socket.socket
    name: str
    uplink: Uplink
    outbox: Outbox
    inbox: deque[Uplinked] = field(default_factory=deque)
    ended: str = ""  # why nothing more comes from it
    dropped: int = 0
    told_drops: int = 0
    is_slow: bool = False  # packets are being dropped
    skipped: int = 0
    resyncs: int = 0


class LinkServer:
    """Serves ground clients.

    Parameters
    ----------
    make_uplink : the cutter of a new client's bytes
    report : told what an operator should know

    Raises
    ------
    PortError when the port cannot be opened.
    """

    def __init__(
        self, config: TelemetryConfig, make_uplink: Callable[[], Uplink], report: Report
    ) -> None:
        self._config, self._make_uplink, self._report = config, make_uplink, report
        self.counters = LinkCounters()
        self._clients: list[_Client] = []
        family = socket.AF_INET6 if ":" in config.host else socket.AF_INET
        self._listener = socket.socket(family, socket.SOCK_STREAM)
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._listener.setblocking(False)
        try:
            self._listener.bind((config.host, config.port))
            self._listener.listen(config.max_clients)
        except OSError as error:
            self._listener.close()
            where = f"{config.host}:{config.port}"
            raise PortError(f"{where}: {error.strerror or error}") from error
        self.port: int = self._listener.getsockname()[1]
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._udp: socket.socket | None = None
        if config.udp is not None:
            self._open_udp(config.udp.host, config.udp.port)

    @property
    def clients(self) -> int:
        """Connected clients."""
        return len(self._clients)

    @property
    def room_bytes(self) -> int:
        """Bytes of a long answer that can be queued now: for the client that reads fastest.

        A quarter of an outbox; without clients as much, for then nothing waits anywhere.
        """
        waiting = [client.outbox.waiting_bytes for client in self._clients]
        return max(0, self._config.queue_bytes // 4 - min(waiting, default=0))

    def send(self, packet: bytes, priority: Priority = Priority.ANSWER) -> None:
        """Queue a packet for every client, push it over UDP."""
        for client in self._clients:
            dropped = client.outbox.put(packet, priority)
            client.dropped += dropped
            self.counters.tm_dropped += dropped
        if self._udp is not None:
            try:
                self._udp.send(packet)
                self.counters.udp_packets += 1
            except OSError:  # nobody listens, or the buffer is full
                self.counters.udp_dropped += 1

    def serve(self, now_ns: int) -> None:
        """Accept new clients and read what has come up into their inboxes."""
        for key, _ in self._selector.select(0):
            if key.data is None:
                self._accept()
            elif len(key.data.inbox) < INBOX_ITEMS:
                self._read(key.data, now_ns)
        for client in list(self._clients):
            self._put(client, client.uplink.expire(now_ns))
            self._watch_uplink(client)
            if client.ended and not client.inbox:
                self._drop(client, client.ended)

    def next_item(self) -> Uplinked | None:
        """Return the next packet or refusal that came up, of each client in turn."""
        for client in self._clients:
            if client.inbox:
                self._clients.remove(client)
                self._clients.append(client)
                return client.inbox.popleft()
        return None

    def flush(self) -> None:
        """Send what the clients take now."""
        for client in list(self._clients):
            while data := client.outbox.next_bytes():
                try:
                    sent = client.connection.send(data)
                except BlockingIOError:
                    break
                except OSError as error:
                    self._end(client, error.strerror or str(error))
                    break
                self.counters.tm_bytes += sent
                self.counters.tm_packets += client.outbox.sent(sent)
                if sent < len(data):
                    break
            client.outbox.rest()
            self._watch_queue(client)

    def close(self) -> None:
        """Close everything, the door first; what a client did not take is lost."""
        self._selector.unregister(self._listener)
        self._listener.close()
        self.flush()
        for client in list(self._clients):
            self._drop(client, "the daemon ends")
        self._selector.close()
        if self._udp is not None:
            self._udp.close()

    def _open_udp(self, host: str, port: int) -> None:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._udp = socket.socket(family, socket.SOCK_DGRAM)
        self._udp.setblocking(False)
        try:
            self._udp.connect((host, port))
        except OSError as error:
            self._report("LINK_FAILED", f"UDP {host}:{port}: {error.strerror or error}")
            self._udp.close()
            self._udp = None

    def _accept(self) -> None:
        try:
            connection, address = self._listener.accept()
        except OSError:
            return
        name = f"{address[0]}:{address[1]}"
        if len(self._clients) >= self._config.max_clients:
            connection.close()
            self._report("LINK_CLOSED", f"{name} refused: {self._config.max_clients} are connected")
            return
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        room = min(self._config.queue_bytes, SYSTEM_BYTES)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, room)
        outbox = Outbox(self._config.queue_bytes)
        client = _Client(connection, name, self._make_uplink(), outbox)
        self._clients.append(client)
        self._selector.register(connection, selectors.EVENT_READ, client)
        self._report("LINK_OPENED", name)

    def _read(self, client: _Client, now_ns: int) -> None:
        try:
            data = client.connection.recv(READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._end(client, "closed by the ground")
            return
        self.counters.tc_bytes += len(data)
        self._put(client, client.uplink.feed(data, now_ns))

    def _put(self, client: _Client, items: list[Uplinked]) -> None:
        """Put what came up into the client's inbox, with the client's name."""
        for item in items:
            source = f"{client.name} {item.source}".strip()
            client.inbox.append(replace(item, source=source))

    def _watch_uplink(self, client: _Client) -> None:
        """Count and tell garbage that is new."""
        skipped, resyncs = client.uplink.skipped_bytes, client.uplink.resyncs
        self.counters.tc_garbage_bytes += skipped - client.skipped
        self.counters.tc_resyncs += resyncs - client.resyncs
        if resyncs > client.resyncs:
            self._report("TC_GARBAGE", f"{client.name}: {skipped - client.skipped} bytes")
        client.skipped, client.resyncs = skipped, resyncs

    def _watch_queue(self, client: _Client) -> None:
        """Tell drops that are new, and that they are over: of all that waited nothing is left."""
        if client.dropped > client.told_drops and not client.is_slow:
            client.is_slow = True
            self._report("LINK_DROPS", f"{client.name} is slow: packets are dropped")
        if client.is_slow and not client.outbox:
            count = client.dropped - client.told_drops
            client.is_slow, client.told_drops = False, client.dropped
            self._report("LINK_CAUGHT_UP", f"{client.name}: {count} packets were dropped")

    def _end(self, client: _Client, why: str) -> None:
        """Read no more of a client; it is dropped once its inbox is empty."""
        if not client.ended:
            self._selector.unregister(client.connection)
            client.ended = why

    def _drop(self, client: _Client, why: str) -> None:
        self._clients.remove(client)
        if not client.ended:
            self._selector.unregister(client.connection)
        client.connection.close()
        self._watch_uplink(client)
        self._watch_queue(client)
        self._report("LINK_CLOSED", f"{client.name}: {why}")
