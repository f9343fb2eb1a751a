"""The link to the ground: one duplex TCP port with raw packets, and an optional UDP push.

Nothing here waits. What a slow client does not take stays in a bounded queue; what does not fit
there is dropped, whole packets only, and counted.
"""

from __future__ import annotations

import selectors
import socket
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from fsw.config.telemetry import TelemetryConfig
from fsw.messages.errors import PortError
from fsw.telemetry.link.splitter import Uplinked
from fsw.telemetry.link.uplink import Uplink

READ_BYTES = 65536
SEND_BYTES = 65536
SYSTEM_BYTES = 1 << 18  # the system's own buffer: what waits there is old when it is taken
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
    queue: deque[bytes] = field(default_factory=deque)
    queued_bytes: int = 0
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

    def send(self, packet: bytes) -> None:
        """Queue a packet for every client, push it over UDP."""
        for client in self._clients:
            if client.queued_bytes + len(packet) > self._config.queue_bytes:
                client.dropped += 1
                self.counters.tm_dropped += 1
                continue
            client.queue.append(packet)
            client.queued_bytes += len(packet)
        if self._udp is not None:
            try:
                self._udp.send(packet)
                self.counters.udp_packets += 1
            except OSError:  # nobody listens, or the buffer is full
                self.counters.udp_dropped += 1

    def serve(self, now_ns: int) -> list[Uplinked]:
        """Take new clients and what has come up."""
        found: list[Uplinked] = []
        for key, _ in self._selector.select(0):
            if key.data is None:
                self._accept()
            else:
                found += self._read(key.data, now_ns)
        for client in self._clients:
            found += client.uplink.expire(now_ns)
            self._watch_uplink(client)
        return found

    def flush(self) -> None:
        """Send what the clients take now."""
        for client in list(self._clients):
            while client.queue:
                parts, size = [], 0
                for packet in client.queue:
                    if size >= SEND_BYTES:
                        break
                    parts.append(packet)
                    size += len(packet)
                data = b"".join(parts)
                try:
                    sent = client.connection.send(data)
                except BlockingIOError:
                    break
                except OSError as error:
                    self._drop(client, error.strerror or str(error))
                    break
                self._account(client, sent)
                if sent < len(data):
                    break
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
        client = _Client(connection, name, self._make_uplink())
        self._clients.append(client)
        self._selector.register(connection, selectors.EVENT_READ, client)
        self._report("LINK_OPENED", name)

    def _read(self, client: _Client, now_ns: int) -> list[Uplinked]:
        try:
            data = client.connection.recv(READ_BYTES)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self._drop(client, "closed by the ground")
            return []
        self.counters.tc_bytes += len(data)
        return client.uplink.feed(data, now_ns)

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
        if client.is_slow and not client.queue:
            count = client.dropped - client.told_drops
            client.is_slow, client.told_drops = False, client.dropped
            self._report("LINK_CAUGHT_UP", f"{client.name}: {count} packets were dropped")

    def _account(self, client: _Client, sent: int) -> None:
        """Take what was sent out of the queue; a packet cut by the system keeps its rest."""
        self.counters.tm_bytes += sent
        client.queued_bytes -= sent
        while sent:
            packet = client.queue[0]
            if len(packet) <= sent:
                sent -= len(packet)
                client.queue.popleft()
                self.counters.tm_packets += 1
            else:
                client.queue[0] = packet[sent:]
                sent = 0

    def _drop(self, client: _Client, why: str) -> None:
        self._clients.remove(client)
        self._selector.unregister(client.connection)
        client.connection.close()
        self._watch_uplink(client)
        self._watch_queue(client)
        self._report("LINK_CLOSED", f"{client.name}: {why}")
