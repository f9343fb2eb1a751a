"""The application's interface to the ground link, usable even if no port could be opened."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict

from fsw.config.telemetry import TelemetryConfig
from fsw.errors import PortError
from fsw.telemetry.dictionary.events import IDS
from fsw.telemetry.link.downlink import Downlink
from fsw.telemetry.link.packets import Packetizer
from fsw.telemetry.link.security import Security
from fsw.telemetry.link.server import LinkCounters, LinkServer
from fsw.telemetry.link.splitter import Uplinked
from fsw.telemetry.link.uplink import (
    ClearUplink,
    LookUplink,
    SecureUplink,
    Uplink,
    security_counters,
)
from fsw.telemetry.ports import Host
from fsw.telemetry.state.event_reporter import EventReporter

MAX_ITEMS = 64  # most received packets that one poll processes
MAX_WORK_NS = 20_000_000  # time after which a poll begins no further packet
NO_SERVER_ROOM_BYTES = 1 << 16  # value of `room_bytes` without a server, which queues nothing


class GroundLink:
    """Connects the downlink and the telecommands to the server.

    Parameters
    ----------
    security : keys and numbers of the authenticated link; None: all packets are sent in clear

    Attributes
    ----------
    server : the opened link; None until `open` has succeeded
    """

    def __init__(
        self,
        config: TelemetryConfig,
        host: Host,
        down: Downlink,
        reporter: EventReporter,
        security: Security | None,
    ) -> None:
        self._config, self._host, self._down = config, host, down
        self._reporter, self.security = reporter, security
        self._refusals = Packetizer()  # has separate counters: only one client receives its packets
        self.server: LinkServer | None = None

    def open(self) -> None:
        """Open the ports of the link; report LINK_FAILED if that is impossible."""
        if self.security is not None:
            self.security.open()
        try:
            self.server = LinkServer(
                self._config,
                self.uplink,
                self._reporter.report,
                seal=self.security.seal if self.security is not None else bytes,
                notice=self._notice,
            )
        except PortError as error:
            self._reporter.report("LINK_FAILED", str(error))
        else:
            self._down.out = self.server.send

    def received(self, now_ns: int) -> Iterator[Uplinked]:
        """Serve the clients; yield received packets within `MAX_ITEMS` and `MAX_WORK_NS`."""
        if self.server is None:
            return
        self.server.serve(now_ns)
        for _ in range(MAX_ITEMS):
            item = self.server.next_item()
            if item is None:
                return
            yield item
            if self._host.now_ns() - now_ns > MAX_WORK_NS:
                return

    def flush(self, now_ns: int) -> None:
        """Send the queued packets as far as the clients accept them."""
        if self.security is not None:
            self.security.poll(now_ns)
        if self.server is not None:
            self.server.flush()

    def close(self) -> None:
        """Close the connections."""
        if self.server is not None:
            self.server.close()

    @property
    def room_bytes(self) -> int:
        """Return how much of a long answer can be queued now [B]."""
        return self.server.room_bytes if self.server is not None else NO_SERVER_ROOM_BYTES

    @property
    def has_receiver(self) -> bool:
        """Return whether files may be sent: a receiver exists, or there is no server at all."""
        return self.server is None or self.server.has_receiver

    def reset_counters(self) -> None:
        """Set the counters of the link to zero."""
        if self.server is not None:
            self.server.counters = LinkCounters()

    def values(self) -> dict[str, object]:
        """Return the link's fields of housekeeping set 8."""
        server, security = self.server, self.security
        counters = asdict(server.counters if server is not None else LinkCounters())
        return {
            "tc_security": security is not None,
            "clients": server.clients if server is not None else 0,
            **counters,
            **security_counters(None if security is None else security.receiver),
        }

    def summary(self) -> Mapping[str, object]:
        """Return ports and counters for the status file."""
        if self.server is None:
            return {"port": None, "look_port": None, "link": {}}
        return {
            "port": self.server.port,
            "look_port": self.server.look_port,
            "link": asdict(self.server.counters),
        }

    def uplink(self, may_command: bool) -> Uplink:
        """Return the reader of a new client's bytes."""
        if not may_command:
            return LookUplink()
        return ClearUplink() if self.security is None else SecureUplink(self.security.receiver)

    def _notice(self, reason: str) -> bytes:
        """Return the event packet that gives a refused client the reason."""
        values = {"event": IDS["LINK_REFUSED"], "occurrence": 1, "suppressed": 0, "text": reason}
        return self._refusals.make("event_low", self._host.now_ns(), values)
