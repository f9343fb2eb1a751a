"""Socket of a live feed: Unix or UDP datagrams, each stamped as it is read."""

import socket
from contextlib import suppress
from ipaddress import ip_address
from pathlib import Path

from fsw.clock import Clock
from fsw.drivers.ports.system_words import of_system
from fsw.drivers.wire import ByteChunk
from fsw.errors import PortError

READ_BYTES = 2048  # more than any datagram of a feed; the rest of a longer one is discarded
MAX_READS = 256  # per call, so that a flood cannot block the loop
BUFFER_BYTES = 1 << 20
MODE = 0o660  # owner and group may send to a Unix socket


def open_feed(place: Path | tuple[str, int], clock: Clock) -> "FeedPort":
    """Open the socket at a path, or at a numeric address and port.

    Raises
    ------
    PortError naming the place, also when another process receives there.
    """
    try:
        line = _unix(place) if isinstance(place, Path) else _udp(*place)
    except OSError as error:
        raise PortError(f"feed {_words(place)}: cannot be opened: {of_system(error)}") from error
    line.setblocking(False)
    with suppress(OSError):
        line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
    return FeedPort(line, clock, place)


def _udp(host: str, port: int) -> socket.socket:
    family = socket.AF_INET if ip_address(host).version == 4 else socket.AF_INET6
    line = socket.socket(family, socket.SOCK_DGRAM)
    return _bound(line, (host, port))


def _unix(path: Path) -> socket.socket:
    """Bind a path; remove the socket that a process which has ended left there."""
    if path.is_socket():
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as probe:
            try:
                probe.connect(str(path))
            except ConnectionRefusedError:
                path.unlink()
            else:
                raise PortError("another process receives here")
    line = _bound(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM), str(path))
    path.chmod(MODE)
    return line


def _bound(line: socket.socket, address: str | tuple[str, int]) -> socket.socket:
    try:
        line.bind(address)
    except OSError:
        line.close()
        raise
    return line


def _words(place: Path | tuple[str, int]) -> str:
    return str(place) if isinstance(place, Path) else f"{place[0]}:{place[1]}"


class FeedPort:
    """An open socket that receives a feed."""

    def __init__(self, line: socket.socket, clock: Clock, place: Path | tuple[str, int]) -> None:
        self._line, self._clock, self._place = line, clock, place

    def read(self) -> list[ByteChunk]:
        """Return the datagrams received since the last call, stamped right after each read."""
        chunks: list[ByteChunk] = []
        while len(chunks) < MAX_READS:
            try:
                data = self._line.recv(READ_BYTES)
            except BlockingIOError:
                break
            except OSError as error:
                raise PortError(f"feed {_words(self._place)}: cannot be read: {error}") from error
            chunks.append(ByteChunk(self._clock.now_ns(), data))
        return chunks

    def write(self, data: bytes) -> None:
        """Do nothing: a feed has no return path."""

    def wake_fds(self) -> tuple[int, ...]:
        """Return the socket's descriptor: a wake by it gives arrivals a fine stamp."""
        return (self._line.fileno(),)

    def close(self) -> None:
        """Release the socket and remove its path."""
        self._line.close()
        if isinstance(self._place, Path):
            self._place.unlink(missing_ok=True)
