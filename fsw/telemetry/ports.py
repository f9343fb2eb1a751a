"""What the telemetry application asks of its neighbours: file delivery, the loop, the recorder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Protocol


class FileDelivery(Protocol):
    """Class 2 file delivery (CFDP); never blocks. Its packets are what goes over the link."""

    def send(self, path: Path, *, remove: bool) -> int:
        """Begin to send a file down; return the transaction's number.

        Raises
        ------
        FswError when it cannot begin.
        """
        ...

    def receive(self, pdu: bytes, now_ns: int) -> None:
        """Take one unit that came up; garbage is counted, never raised."""
        ...

    def poll(self, now_ns: int) -> list[bytes]:
        """Return units to send down now, few enough for one look of the service."""
        ...

    def finished(self) -> list[tuple[int, bool, str]]:
        """Return transactions that ended since the last call: number, success, text.

        A file that came up on the ground's initiative has number 0; the text names it.
        """
        ...

    def counters(self) -> Mapping[str, int]:
        """Return files_sent, files_received, files_failed, pdus_sent, pdus_received."""
        ...
