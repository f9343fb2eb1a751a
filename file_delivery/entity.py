"""File delivery of class 2 (CCSDS 727.0-B), both ways, one file each way at a time.

The state machines are cfdp-py's. Added here and in the halves: limits on what the other end may ask
for, a transaction timeout, answers for transactions that are over, names confined to the file
directory, the checksum of every file, and files that take their place only when they are whole.
"""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Mapping
from pathlib import Path

from spacepackets.cfdp import ConditionCode
from spacepackets.cfdp.pdu.helper import GenericPduPacket, PduHolder

from file_delivery.errors import DeliveryError
from file_delivery.library import DAEMON, GROUND, Pair
from file_delivery.receiver import FileReceiver
from file_delivery.sender import FileSender
from file_delivery.units import (
    UnitError,
    is_for_sender,
    late_acknowledgement,
    packed,
    parse,
    transaction_of,
)

UNITS_PER_LOOK = 32  # sent in one look of the service, every 10 ms
REMEMBERED = 64  # transactions that are over
MAX_FILE_BYTES = 1 << 30
COUNTED = (
    "files_sent",
    "files_received",
    "files_failed",
    "pdus_sent",
    "pdus_received",
    "pdus_rejected",
)


DAEMONS = Pair(here=DAEMON, there=GROUND)


class FileEntity:
    """One end of file delivery; blocks no longer than reading or checking one file.

    Parameters
    ----------
    directory : all files are below it, by names relative to it
    first_number : of the first transaction; other than those of the last run
    ends : the daemon's by default
    """

    def __init__(
        self,
        directory: Path,
        first_number: int = 0,
        *,
        max_file_bytes: int = MAX_FILE_BYTES,
        ends: Pair = DAEMONS,
    ) -> None:
        self._directory = directory
        self._max_file_bytes, self._here = max_file_bytes, ends.here
        self._sender = FileSender(directory, ends, first_number)
        self._receiver = FileReceiver(directory, ends)
        self._late: list[bytes] = []
        self._over: OrderedDict[tuple[int, int], ConditionCode] = OrderedDict()
        self._ended: list[tuple[int, bool, str]] = []
        self._counters: Counter[str] = Counter()

    def send(self, path: Path, *, remove: bool, name: str = "") -> int:
        """Begin to send a file; return the transaction's number, at least 1.

        Parameters
        ----------
        path : below the directory; relative to it, or whole
        remove : remove it here once it has arrived
        name : at the other end; empty: its name without the folders here

        Raises
        ------
        DeliveryError FILE_NOT_FOUND or BUSY.
        """
        if path.is_absolute() and path.is_relative_to(self._directory):
            path = path.relative_to(self._directory)
        return self._sender.send(path, name or path.name, remove=remove)

    def receive(self, pdu: bytes, now_ns: int) -> None:
        """Take one unit that came; what is none, or fits nowhere, is counted."""
        self._counters["pdus_received"] += 1
        try:
            unit = parse(pdu, self._max_file_bytes)
            if transaction_of(unit) == self._receiver.transaction:
                self._receiver.take(unit, now_ns)
            elif transaction_of(unit) in self._over:
                self._answer_late(unit)
            elif is_for_sender(unit):
                self._sender.answer(unit, now_ns)
            else:
                self._receiver.take(unit, now_ns)
        except (UnitError, DeliveryError):
            self._counters["pdus_rejected"] += 1
        self._collect()

    def poll(self, now_ns: int) -> list[bytes]:
        """Return units to send now; a few, so that nobody else waits for them."""
        units, self._late = self._late[:UNITS_PER_LOOK], self._late[UNITS_PER_LOOK:]
        units += self._receiver.poll(UNITS_PER_LOOK - len(units), now_ns)
        units += self._sender.pump(UNITS_PER_LOOK - len(units), now_ns)
        self._counters["pdus_sent"] += len(units)
        self._collect()
        return units

    def finished(self) -> list[tuple[int, bool, str]]:
        """Return what ended since the last call: number (0: it came here), success, text."""
        ended, self._ended = self._ended, []
        return ended

    def counters(self) -> Mapping[str, int]:
        """Return files_sent, files_received, files_failed, pdus_sent, pdus_received, _rejected."""
        return {name: self._counters[name] for name in COUNTED}

    def _answer_late(self, unit: GenericPduPacket) -> None:
        answer = late_acknowledgement(unit, self._over[transaction_of(unit)])
        reply = packed(PduHolder(answer))
        if reply is not None and len(self._late) < UNITS_PER_LOOK:
            self._late.append(reply)

    def _collect(self) -> None:
        for number, condition, text in self._sender.ended:
            self._note((self._here, number), condition, number, text, "files_sent")
        for key, condition, text in self._receiver.ended:
            self._note(key, condition, 0, text, "files_received")
        self._sender.ended, self._receiver.ended = [], []

    def _note(
        self, key: tuple[int, int], condition: ConditionCode, number: int, text: str, counter: str
    ) -> None:
        good = condition == ConditionCode.NO_ERROR
        self._over[key] = condition
        while len(self._over) > REMEMBERED:
            self._over.popitem(last=False)
        self._counters[counter if good else "files_failed"] += 1
        self._ended.append((number, good, text))
