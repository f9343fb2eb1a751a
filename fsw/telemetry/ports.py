"""Interfaces that the telemetry application needs: file delivery, the loop, the recorder."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from file_delivery.transfer import Key, Transfer
from fsw.config import Config
from fsw.messages.commands import Command
from fsw.telemetry.state.epoch import Epoch


class FileDelivery(Protocol):
    """Class 2 file delivery (CFDP); no method blocks. The link carries its units (PDUs)."""

    def send(
        self, path: Path, *, remove: bool, name: str = "", piece: tuple[int, int] | None = None
    ) -> int:
        """Begin to send a file down; return the transaction's number, at least 1.

        Parameters
        ----------
        name : file name at the other end; empty: the same name as here
        piece : offset and size of the part to send [B]; None: the whole file

        Raises
        ------
        DeliveryError when sending cannot begin; its code is an error name of the dictionary.
        """
        ...

    def receive(self, pdu: bytes, now_ns: int) -> None:
        """Process one received unit; an invalid unit is counted and raises no error."""
        ...

    def poll(self, now_ns: int) -> list[bytes]:
        """Return the units to send down now, few enough for one poll of the service."""
        ...

    def finished(self) -> list[tuple[int, bool, str]]:
        """Return number, success and text of each transaction that ended since the last call.

        A file that the ground sent on its own initiative has number 0; the text names the file.
        """
        ...

    def transfers(self) -> list[Transfer]:
        """Return the transfers that have not ended."""
        ...

    def cancel(self, key: Key) -> None:
        """End a transfer at both ends. Raises DeliveryError FILE_NOT_FOUND."""
        ...

    def suspend(self, key: Key) -> None:
        """Suspend a transfer. Raises DeliveryError FILE_NOT_FOUND."""
        ...

    def resume(self, key: Key, now_ns: int) -> None:
        """Continue a suspended transfer. Raises DeliveryError FILE_NOT_FOUND."""
        ...

    def counters(self) -> Mapping[str, int]:
        """Return the counts files_sent, files_received, files_failed, pdus_sent, pdus_received."""
        ...


class Recording(Protocol):
    """The recorder, as telecommands see it."""

    @property
    def path(self) -> Path | None:
        """Return the path of the present or last recording; None before the first one."""
        ...

    def values(self) -> Mapping[str, Any]:
        """Return the values recording, failed_messages, dropped_messages and recordings."""
        ...

    def start(self) -> None:
        """Begin a recording. Raises CommandError."""
        ...

    def stop(self) -> None:
        """Close the recording. Raises CommandError."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Host:
    """Interface to the service process around the telemetry application.

    Parameters
    ----------
    now_ns, epoch : return mission elapsed time [ns], and its origin
    forward : sends a command to the loop; returns False when the ring is full
    report : reports an event; its arguments are severity, code and text
    configured : receives the new effective configuration
    """

    now_ns: Callable[[], int]
    epoch: Callable[[], Epoch]
    forward: Callable[[Command], bool]
    report: Callable[[str, str, str], None]
    configured: Callable[[Config], None]
    recording: Recording
