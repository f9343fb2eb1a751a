"""A connection to the daemon: packets down, telecommands up, in clear or sealed."""

import secrets
import socket
import time
from collections.abc import Iterator

from ground.downlink import ClearStream, PacketStream
from ground.errors import LinkError
from ground.sdls import Sealer

CONNECT_TIMEOUT_S = 5.0
READ_BYTES = 65536
COUNT_14 = 1 << 14


class Link:
    """One TCP connection.

    Parameters
    ----------
    sealer : seals telecommands; None: they are in clear, which the daemon accepts on loopback only
    stream : splits the received bytes into packets; None: the packets are in clear

    Raises
    ------
    LinkError when the daemon cannot be reached.
    """

    def __init__(
        self, host: str, port: int, sealer: Sealer | None, stream: PacketStream | None = None
    ) -> None:
        self.sealer = sealer
        self.stream = stream or ClearStream()
        self.is_heard = False  # whether a packet was received
        self._sequence = secrets.randbelow(COUNT_14)
        try:
            self._socket = socket.create_connection((host, port), CONNECT_TIMEOUT_S)
        except OSError as error:
            raise LinkError(f"{host}:{port}: {error.strerror or error}") from error

    def next_sequence(self) -> int:
        """Return the sequence count of the next telecommand; the first one is random."""
        self._sequence = (self._sequence + 1) % COUNT_14
        return self._sequence

    def send(self, packet: bytes) -> None:
        """Send one packet. Raises LinkError."""
        data = packet if self.sealer is None else self.sealer.seal(packet)
        try:
            self._socket.sendall(data)
        except OSError as error:
            raise LinkError(f"lost: {error.strerror or error}") from error

    def packets(self, until_s: float) -> Iterator[bytes]:
        """Yield packets until a time of the monotonic clock [s]. Raises LinkError: link lost."""
        while True:
            for packet in self.stream.packets():
                self.is_heard = True
                yield packet
            left_s = until_s - time.monotonic()
            if left_s <= 0.0:
                return
            self._socket.settimeout(left_s)
            try:
                data = self._socket.recv(READ_BYTES)
            except TimeoutError:
                return
            except OSError as error:
                raise LinkError(f"lost: {error.strerror or error}") from error
            if not data:
                raise LinkError("the daemon has closed the connection")
            self.stream.add(data)

    def close(self) -> None:
        """Close the stream and the connection."""
        self.stream.close()
        self._socket.close()
