"""The link to the ground: a TCP port to command, one to observe only, and optional UDP output.

No method waits. Packets that a slow client does not read stay in a bounded outbox; packets that do
not fit are dropped whole, and counted. Packets from a client stay in its inbox until `next_item`
returns them; while the inbox is full, the client's bytes stay in the system's buffers.
"""

import selectors
import socket
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

from fsw.config.telemetry import TelemetryConfig
from fsw.errors import PortError
from fsw.telemetry.link.outbox import Outbox, Priority
from fsw.telemetry.link.places import LinkClient, Refusal, admit, overdue, promote
from fsw.telemetry.link.splitter import Uplinked
from fsw.telemetry.link.uplink import Uplink

READ_BYTES = 16384
INBOX_ITEMS = 256  # packets in a client's inbox at which no more of its bytes are read
SYSTEM_BYTES = 1 << 16  # size of the system's buffer, in which no packet overtakes another
Report = Callable[[str, str], object]  # event code, text


@dataclass(slots=True)
class LinkCounters:
    """Counts of bytes and packets over the link, of all clients, since the start or last reset."""

    tm_packets: int = 0
    tm_bytes: int = 0
    tm_dropped: int = 0
    tc_bytes: int = 0
    tc_garbage_bytes: int = 0
    tc_resyncs: int = 0
    udp_packets: int = 0
    udp_dropped: int = 0


class LinkServer:
    """Serves ground clients.

    Parameters
    ----------
    make_uplink : makes the reader of a new client's bytes; its argument: whether it may command
    report : reports an event; its arguments are code and text
    seal : returns the bytes on the wire for a packet
    notice : returns the packet that gives a refused client the reason

    Raises
    ------
    PortError when a port cannot be opened.
    """

    def __init__(
        self,
        config: TelemetryConfig,
        make_uplink: Callable[[bool], Uplink],
        report: Report,
        *,
        seal: Callable[[bytes], bytes] = lambda packet: packet,
        notice: Callable[[str], bytes] = lambda _reason: b"",
    ) -> None:
        self._config, self._make_uplink, self._report = config, make_uplink, report
        self._seal, self._notice = seal, notice
        self._idle_ns = round(config.idle_timeout_s * 1e9)
        self.counters = LinkCounters()
        self._clients: list[LinkClient] = []
        self._selector = selectors.DefaultSelector()
        self._now_ns = 0
        self._doors: dict[socket.socket, bool] = {}  # listener: whether its clients may command
        try:
            self.port = self._open_door(config.port, may_command=True)
            self.look_port = 0
            if config.look_port is not None:
                self.look_port = self._open_door(config.look_port, may_command=False)
        except PortError:
            self._close_doors()
            raise
        self._udp: socket.socket | None = None
        if config.udp is not None:
            self._open_udp(config.udp.host, config.udp.port)

    @property
    def has_receiver(self) -> bool:
        """Return whether a client is connected or packets are sent over UDP."""
        return bool(self._clients) or self._udp is not None

    @property
    def clients(self) -> int:
        """Return the number of connected clients."""
        return len(self._clients)

    @property
    def room_bytes(self) -> int:
        """Return how much of a long answer can be queued now [B].

        This is a quarter of an outbox minus the waiting bytes of the client that reads fastest.
        """
        waiting = [client.outbox.waiting_bytes for client in self._clients]
        return max(0, self._config.queue_bytes // 4 - min(waiting, default=0))

    def send(self, packet: bytes, priority: Priority = Priority.ANSWER) -> None:
        """Queue a packet for every client, and send it over UDP if that is configured."""
        for client in self._clients:
            dropped = client.outbox.put(packet, priority)
            client.dropped += dropped
            self.counters.tm_dropped += dropped
        if self._udp is not None:
            try:
                self._udp.send(self._seal(packet))
                self.counters.udp_packets += 1
            except OSError:  # nobody listens, or the buffer is full
                self.counters.udp_dropped += 1

    def serve(self, now_ns: int) -> None:
        """Accept new clients, read packets into the inboxes, disconnect overdue clients."""
        self._now_ns = now_ns
        for key, _ in self._selector.select(0):
            if key.fileobj in self._doors:
                self._accept(key.fileobj)
            elif len(key.data.inbox) < INBOX_ITEMS:
                self._read(key.data, now_ns)
        for client in list(self._clients):
            self._put(client, client.uplink.expire(now_ns))
            self._watch_uplink(client)
            if client.ended and not client.inbox:
                self._drop(client, client.ended)
                continue
            self._refuse(overdue(client, now_ns, self._idle_ns, self._config.max_clients))

    def next_item(self) -> Uplinked | None:
        """Return the next received packet, from each client in turn; None if there is none."""
        for client in self._clients:
            if client.inbox:
                self._clients.remove(client)
                self._clients.append(client)
                return client.inbox.popleft()
        return None

    def flush(self) -> None:
        """Send as much as the clients accept now."""
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
                client.read_ns = self._now_ns
                if sent < len(data):
                    break
            if not client.outbox:
                client.read_ns = self._now_ns
            client.outbox.rest()
            self._watch_queue(client)

    def close(self) -> None:
        """Close everything, listening sockets first; bytes that a client has not read are lost."""
        self._close_doors()
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

    def _open_door(self, port: int, *, may_command: bool) -> int:
        """Listen on a port; return the number of the opened port. Raises PortError."""
        host = self._config.host
        listener = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.setblocking(False)
        try:
            listener.bind((host, port))
            listener.listen(self._config.max_clients)
        except OSError as error:
            listener.close()
            raise PortError(f"{host}:{port}: {error.strerror or error}") from error
        self._doors[listener] = may_command
        self._selector.register(listener, selectors.EVENT_READ)
        return int(listener.getsockname()[1])

    def _close_doors(self) -> None:
        for listener in self._doors:
            self._selector.unregister(listener)
            listener.close()
        self._doors.clear()

    def _accept(self, listener: socket.socket) -> None:
        try:
            connection, address = listener.accept()
        except OSError:
            return
        name = f"{address[0]}:{address[1]}"
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, self._idle_ns // 10**6)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        room = min(self._config.queue_bytes, SYSTEM_BYTES)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, room)
        may_command, now_ns = self._doors[listener], self._now_ns
        outbox = Outbox(self._config.queue_bytes, self._seal)
        uplink = self._make_uplink(may_command)
        client = LinkClient(connection, name, uplink, outbox, now_ns, may_command, now_ns)
        refusal = admit(client, self._clients, self._config.max_clients)
        self._clients.append(client)
        self._selector.register(connection, selectors.EVENT_READ, client)
        if refusal is None or refusal.client is not client:
            self._report("LINK_OPENED", name)
        self._refuse(refusal)

    def _refuse(self, refusal: Refusal | None) -> None:
        """Close a connection; its last packet gives the reason."""
        if refusal is None or refusal.client not in self._clients:
            return
        client, reason = refusal.client, refusal.reason
        client.outbox.put(self._notice(f"{client.name}: {reason}"), Priority.HEALTH)
        client.outbox.rest()
        with suppress(OSError):  # a client that does not read receives no reason
            client.connection.send(client.outbox.next_bytes())
        self._remove(client)
        self._report("LINK_REFUSED", f"{client.name}: {reason}")

    def _read(self, client: LinkClient, now_ns: int) -> None:
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

    def _put(self, client: LinkClient, items: list[Uplinked]) -> None:
        """Put received packets into the client's inbox, with the client's name."""
        for item in items:
            source = f"{client.name} {item.source}".strip()
            client.inbox.append(replace(item, source=source))
        if client.may_command and any(item.error is None for item in items):
            others = [other for other in self._clients if other is not client]
            self._refuse(promote(client, others, self._config.max_clients))

    def _watch_uplink(self, client: LinkClient) -> None:
        """Count and report the invalid bytes received since the last call."""
        skipped, resyncs = client.uplink.skipped_bytes, client.uplink.resyncs
        self.counters.tc_garbage_bytes += skipped - client.skipped
        self.counters.tc_resyncs += resyncs - client.resyncs
        if resyncs > client.resyncs:
            self._report("TC_GARBAGE", f"{client.name}: {skipped - client.skipped} bytes")
        client.skipped, client.resyncs = skipped, resyncs

    def _watch_queue(self, client: LinkClient) -> None:
        """Report new drops, and report their end once the client's queue is empty."""
        if client.dropped > client.reported_drops and not client.is_slow:
            client.is_slow = True
            self._report("LINK_DROPS", f"{client.name} is slow: packets are dropped")
        if client.is_slow and not client.outbox:
            count = client.dropped - client.reported_drops
            client.is_slow, client.reported_drops = False, client.dropped
            self._report("LINK_CAUGHT_UP", f"{client.name}: {count} packets were dropped")

    def _end(self, client: LinkClient, why: str) -> None:
        """Stop reading from a client; it is disconnected once its inbox is empty."""
        if not client.ended:
            self._selector.unregister(client.connection)
            client.ended = why

    def _drop(self, client: LinkClient, why: str) -> None:
        self._remove(client)
        self._report("LINK_CLOSED", f"{client.name}: {why}")

    def _remove(self, client: LinkClient) -> None:
        self._clients.remove(client)
        if not client.ended:
            self._selector.unregister(client.connection)
        client.connection.close()
        self._watch_uplink(client)
        self._watch_queue(client)
