"""A TCP relay between ground and daemon that can be cut and mended like a cable."""

import contextlib
import socket
import threading
from collections.abc import Callable

CHUNK_BYTES = 65536


class Cable:
    """Relays connections to the daemon; refuses all connections while the cable is cut.

    Parameters
    ----------
    target : returns the daemon's current port
    """

    def __init__(self, target: Callable[[], int]) -> None:
        self._target = target
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._held: list[socket.socket] = []
        self._lock = threading.Lock()
        self._cut = False
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        """Break every connection and refuse new connections."""
        with self._lock:
            self._cut = True
            held, self._held = self._held, []
        for end in held:
            _end(end)

    def mend(self) -> None:
        """Relay new connections again."""
        with self._lock:
            self._cut = False

    def close(self) -> None:
        """Cut the cable for good and close its port."""
        self.cut()
        _end(self._listener)

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            try:
                far = socket.create_connection(("127.0.0.1", self._target()), 5.0)
                far.settimeout(None)
            except OSError:
                _end(near)
                continue
            with self._lock:
                if self._cut:
                    _end(near)
                    _end(far)
                    continue
                self._held += [near, far]
            for pair in ((near, far), (far, near)):
                threading.Thread(target=_carry, args=pair, daemon=True).start()


def _carry(source: socket.socket, sink: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while data := source.recv(CHUNK_BYTES):
            sink.sendall(data)
    _end(source)
    _end(sink)


def _end(end: socket.socket) -> None:
    with contextlib.suppress(OSError):
        end.shutdown(socket.SHUT_RDWR)
    end.close()
