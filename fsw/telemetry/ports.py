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
    """Class 2 file delivery (CFDP); never blocks. Its packets are what goes over the link."""

    def send(
        self, path: Path, *, remove: bool, name: str = "", piece: tuple[int, int] | None = None
    ) -> int:
        """Begin to send a file down; return the transaction's number, at least 1.

        Parameters
        ----------
        name : at the other end; empty: its own
        piece : offset and size [B] of what to send; None: all

        Raises
        ------
        DeliveryError when it cannot begin; its code is a name of the dictionary's errors.
        """
        ...

    def receive(self, pdu: bytes, now_ns: int) -> None:
        """Process one received unit; an invalid unit is counted and raises nothing."""
        ...

    def poll(self, now_ns: int) -> list[bytes]:
        """Return units to send down now, few enough for one look of the service."""
        ...

    def finished(self) -> list[tuple[int, bool, str]]:
        """Return transactions that ended since the last call: number, success, text.

        A file that came up on the ground's initiative has number 0; the text names it.
        """
        ...

    def transfers(self) -> list[Transfer]:
        """Return the transfers that are not over."""
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
        """Return files_sent, files_received, files_failed, pdus_sent, pdus_received."""
        ...


class Recording(Protocol):
    """The recorder, as telecommands see it."""

    @property
    def path(self) -> Path | None:
        """Return the recording in progress, or the last one."""
        ...

    def values(self) -> Mapping[str, Any]:
        """Return recording, failed_messages, dropped_messages, recordings."""
        ...

    def start(self) -> None:
        """Begin a recording. Raises CommandError."""
        ...

    def stop(self) -> None:
        """Close the recording. Raises CommandError."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Host:
    """The service process around the telemetry application.

    Parameters
    ----------
    epoch : the origin of `now_ns`
    forward : sends a command to the loop; returns False when the ring is full
    report : reports an event: severity, code, text
    configured : receives the new effective configuration
    """

    now_ns: Callable[[], int]
    epoch: Callable[[], Epoch]
    forward: Callable[[Command], bool]
    report: Callable[[str, str, str], None]
    configured: Callable[[Config], None]
    recording: Recording
