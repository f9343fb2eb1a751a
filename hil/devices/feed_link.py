"""The sender's end of a live feed in real time: UDP on the loopback address."""

import socket

SURE_SENDS = 3  # a refusal is reported by the next send at the latest


class FeedEnd:
    """Sends datagrams; those that nobody receives, or for which there is no room, are dropped."""

    def __init__(self, device: str, host: str, port: int) -> None:
        self.device = device
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.connect((host, port))
        self._accepted = 0  # sends in a row without a refusal
        self.dropped_bytes = 0

    @property
    def is_received(self) -> bool:
        """Whether a host receives the datagrams."""
        return self._accepted >= SURE_SENDS

    def send(self, data: bytes) -> None:
        """Send one datagram."""
        try:
            self._socket.send(data)
            self._accepted += 1
        except ConnectionRefusedError:  # the host does not listen yet, or no longer
            self._accepted = 0
        except BlockingIOError:
            self.dropped_bytes += len(data)

    def close(self) -> None:
        """Release the socket."""
        self._socket.close()
