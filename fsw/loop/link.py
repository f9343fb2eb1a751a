"""One device link of the loop: a port that may be lost, and the attempts to open it again."""

from collections.abc import Callable
from typing import Generic, TypeVar

from fsw.drivers.wire import BytePort, FramePort
from fsw.errors import PortError

RETRY_NS = 500_000_000  # an attempt is cheap, and a returned device must be in use within 1 s

P = TypeVar("P", FramePort, BytePort)


class Link(Generic[P]):
    """A port that may be lost and can be opened again.

    Parameters
    ----------
    name : name of the link in events and telemetry
    port : the open port; None when it could not be opened yet
    opener : opens the port again; None: a lost port stays lost
    """

    def __init__(self, name: str, port: P | None, opener: Callable[[], P] | None) -> None:
        self.name = name
        self.port: P | None = port
        self.losses = 0 if port is not None else 1
        self._opener: Callable[[], P] | None = opener
        self._next_try_ns = 0

    @property
    def up(self) -> bool:
        """Whether the port is open."""
        return self.port is not None

    def summary(self) -> dict[str, int]:
        """Return whether the port is open (`up`) and how often it was lost (`losses`)."""
        return {"up": self.up, "losses": self.losses}

    def wake_fds(self) -> tuple[int, ...]:
        """Return the descriptors of the open port; none while the port is lost."""
        return self.port.wake_fds() if self.port is not None else ()

    def lose(self, now_ns: int) -> None:
        """Close the port after a failure and count the loss; `retry` waits for `RETRY_NS`."""
        self.close()
        self.losses += 1
        self._next_try_ns = now_ns + RETRY_NS

    def retry(self, now_ns: int) -> bool:
        """Try to open a lost port, at most twice a second; return True if this opened the port."""
        if self.port is not None or self._opener is None or now_ns < self._next_try_ns:
            return False
        try:
            self.port = self._opener()
        except PortError:
            self._next_try_ns = now_ns + RETRY_NS
            return False
        return True

    def close(self) -> None:
        """Release the port; ignore a PortError."""
        port, self.port = self.port, None
        if port is not None:
            try:
                port.close()
            except PortError:
                return
