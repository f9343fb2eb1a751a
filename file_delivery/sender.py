"""Files on their way down, one at a time; the others wait."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from pathlib import Path

from cfdppy.handler.source import SourceHandler
from cfdppy.request import PutRequest
from cfdppy.user import TransactionFinishedParams
from spacepackets.cfdp import ConditionCode, TransmissionMode
from spacepackets.cfdp.pdu import DirectiveType, FinishedPdu, NakPdu, TransactionStatus
from spacepackets.cfdp.pdu.helper import GenericPduPacket
from spacepackets.seqcount import SeqCountProvider
from spacepackets.util import ByteFieldU8

from file_delivery.errors import DeliveryError
from file_delivery.library import (
    REFUSALS,
    TIMEOUT_S,
    CheckTimers,
    Ends,
    Pair,
    is_good,
    local_entity,
    remote_entity,
)
from file_delivery.paths import confined
from file_delivery.units import (
    UnitError,
    acknowledgement,
    checked_request,
    packed,
    transaction_of,
)

NUMBER_BITS = 8  # LibreCube answers with one byte, whatever it was asked with
WAITING_LIMIT = 8  # files
INBOUND_LIMIT = 256  # units that wait for the state machine


@dataclass(slots=True)
class _File:
    handler: SourceHandler
    number: int
    path: Path  # below the directory
    name: str  # at the other end
    remove: bool
    size: int
    last_ns: int = 0  # of the newest word from the other end, or of new data sent
    inbound: deque[GenericPduPacket] = field(default_factory=lambda: deque(maxlen=INBOUND_LIMIT))


class FileSender:
    """The sending half of this end.

    Parameters
    ----------
    directory : files are named relative to it
    ends : who this is, and who the other
    first_number : of the first transaction; other than those of the last run
    """

    def __init__(self, directory: Path, ends: Pair, first_number: int) -> None:
        self._directory, self._ends = directory, ends
        self._user = Ends(directory, self._note_end)
        self._number = first_number
        self._waiting: deque[_File] = deque()
        self._file: _File | None = None
        self.ended: list[tuple[int, ConditionCode, str]] = []

    def send(self, path: Path, name: str, *, remove: bool) -> int:
        """Queue a file that is to have this name there; return its transaction's number.

        Raises
        ------
        DeliveryError FILE_NOT_FOUND or BUSY.
        """
        file = confined(self._directory, str(path))
        if not file.is_file():
            raise DeliveryError("FILE_NOT_FOUND", str(path))
        if len(self._waiting) >= WAITING_LIMIT:
            raise DeliveryError("BUSY", f"{WAITING_LIMIT} files wait to be sent")
        self._number = number = self._number % ((1 << NUMBER_BITS) - 1) + 1
        numbers = SeqCountProvider(NUMBER_BITS)
        numbers.count = number
        handler = SourceHandler(
            local_entity(self._ends.here),
            self._user,
            remote_entity(self._ends.there),
            CheckTimers(),
            numbers,
        )
        path = file.relative_to(self._directory.resolve())
        self._waiting.append(_File(handler, number, path, name, remove, file.stat().st_size))
        return number

    def answer(self, unit: GenericPduPacket, now_ns: int) -> None:
        """Take a unit about the file on its way. Raises UnitError when it is about none."""
        file = self._file
        if file is None or transaction_of(unit) != (self._ends.here, file.number):
            raise UnitError("no such transaction")
        if isinstance(unit, NakPdu):
            unit = checked_request(unit, file.size)
        file.last_ns = now_ns
        if isinstance(unit, FinishedPdu):
            # it says that the end was announced, should that acknowledgement have been lost
            file.inbound.append(
                acknowledgement(
                    unit, DirectiveType.EOF_PDU, unit.condition_code, TransactionStatus.ACTIVE
                )
            )
        file.inbound.append(unit)

    def pump(self, limit: int, now_ns: int) -> list[bytes]:
        """Return at most so many units to send now."""
        if self._file is None and self._waiting:
            self._begin(self._waiting.popleft(), now_ns)
        file, units = self._file, list[bytes]()
        while file is not None and len(units) < limit:
            holder = file.handler.get_next_packet()
            if holder is not None:
                unit_bytes = packed(holder)
                if unit_bytes is not None:
                    units.append(unit_bytes)
                continue
            if self._file is not file:
                break  # over, and its last acknowledgement is sent
            progress = file.handler.progress
            unit = file.inbound.popleft() if file.inbound else None
            try:
                file.handler.state_machine(unit)
            except REFUSALS as error:
                if isinstance(error, OSError):
                    self._give_up(file, str(error))
            if file.handler.progress != progress:
                file.last_ns = now_ns
            if unit is None and not file.handler.packets_ready:
                break
        if file is not None and self._file is file and now_ns - file.last_ns > TIMEOUT_S * 1e9:
            self._give_up(file, f"no answer for {TIMEOUT_S:g} s")
        return units

    def _begin(self, file: _File, now_ns: int) -> None:
        file.last_ns = now_ns
        request = PutRequest(
            destination_id=ByteFieldU8(self._ends.there),
            source_file=file.path,
            dest_file=Path(file.name),
            trans_mode=TransmissionMode.ACKNOWLEDGED,
            closure_requested=True,
        )
        self._file = file
        try:
            file.handler.put_request(request)
        except REFUSALS as error:  # removed while it waited
            self._give_up(file, str(error))

    def _note_end(self, params: TransactionFinishedParams) -> None:
        file, outcome = self._file, params.finished_params
        if file is None:
            return
        self._file = None
        if not is_good(outcome):
            text = f"{file.path}: {outcome.condition_code.name}"
            if outcome.condition_code == ConditionCode.NO_ERROR:
                text = f"{file.path}: {outcome.delivery_code.name}, {outcome.file_status.name}"
            self.ended.append((file.number, ConditionCode.CANCEL_REQUEST_RECEIVED, text))
            return
        if file.remove:
            (self._directory / file.path).unlink(missing_ok=True)
        self.ended.append((file.number, ConditionCode.NO_ERROR, str(file.path)))

    def _give_up(self, file: _File, reason: str) -> None:
        self._file = None
        text = f"{file.path}: {reason}"
        self.ended.append((file.number, ConditionCode.INACTIVITY_DETECTED, text))
