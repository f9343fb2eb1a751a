"""Files on their way here, one at a time; a file takes its place only when it is whole."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from pathlib import Path

from cfdppy.defs import CfdpState
from cfdppy.handler.dest import DestHandler, LostSegmentTracker
from cfdppy.user import TransactionFinishedParams
from spacepackets.cfdp import ChecksumType, ConditionCode, TransmissionMode
from spacepackets.cfdp.pdu import (
    DirectiveType,
    EofPdu,
    FileDataPdu,
    MetadataPdu,
    NakPdu,
    TransactionStatus,
)
from spacepackets.cfdp.pdu.finished import DeliveryCode, FinishedParams
from spacepackets.cfdp.pdu.helper import GenericPduPacket, PduHolder

from file_delivery.library import (
    REFUSALS,
    TIMEOUT_S,
    TIMER_S,
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
    packed,
    renamed,
    towards_sender,
    transaction_of,
)

PARTIAL = ".incoming-"
REPLIES_LIMIT = 256
STARTING = (MetadataPdu, FileDataPdu, EofPdu)


@dataclass(slots=True)
class _File:
    key: tuple[int, int]  # of the transaction
    last_ns: int  # of the newest unit
    name: str = ""  # as the other end wants it; empty until the metadata are there
    checksum_type: ChecksumType = ChecksumType.NULL_CHECKSUM
    end: EofPdu | None = None
    asked_ns: int | None = None  # when the metadata were asked for
    started: bool = False  # the library knows of it
    over: bool = False  # only the acknowledgement of the end is still awaited

    @property
    def partial(self) -> str:
        """What the file is called until it is whole."""
        return f"{PARTIAL}{self.key[0]}-{self.key[1]}"


class FileReceiver:
    """The receiving half of this end."""

    def __init__(self, directory: Path, ends: Pair) -> None:
        self._directory, self._ends = directory, ends
        self._user = Ends(directory, self._note_end)
        self._handler = DestHandler(
            local_entity(ends.here), self._user, remote_entity(ends.there), CheckTimers()
        )
        self._file: _File | None = None
        self._replies: deque[bytes] = deque(maxlen=REPLIES_LIMIT)
        self.ended: list[tuple[tuple[int, int], ConditionCode, str]] = []
        for left in directory.glob(f"{PARTIAL}*"):  # of a run that did not end well
            left.unlink(missing_ok=True)

    @property
    def transaction(self) -> tuple[int, int] | None:
        """The transaction under way."""
        return self._file.key if self._file is not None else None

    def take(self, unit: GenericPduPacket, now_ns: int) -> None:
        """Take a unit of a file that comes.

        Raises
        ------
        UnitError or DeliveryError when it is not used.
        """
        file = self._file
        if file is not None and file.over and transaction_of(unit) != file.key:
            self._abandon(file, "")  # the last acknowledgement will not come
            file = None
        if file is None:
            file = self._begin(unit, now_ns)
        elif transaction_of(unit) != file.key:
            raise UnitError("another transaction is under way")
        file.last_ns = now_ns
        if isinstance(unit, MetadataPdu):
            unit = self._with_own_name(file, unit)
        elif not file.name:
            self._ask_for_metadata(file, unit, now_ns)
            return
        elif isinstance(unit, EofPdu):
            if file.end is not None:  # its acknowledgement was lost; the library would be silent
                kind, condition = DirectiveType.EOF_PDU, unit.condition_code
                self._reply(acknowledgement(unit, kind, condition, TransactionStatus.ACTIVE))
                return
            file.end = unit
        self._feed(unit)

    def poll(self, limit: int, now_ns: int) -> list[bytes]:
        """Return at most so many units to send now."""
        file = self._file
        if file is not None:
            if file.started:
                self._feed(None)
            if now_ns - file.last_ns > TIMEOUT_S * 1e9:
                self._abandon(file, f"nothing came for {TIMEOUT_S:g} s")
        return [self._replies.popleft() for _ in range(min(limit, len(self._replies)))]

    def _begin(self, unit: GenericPduPacket, now_ns: int) -> _File:
        if not isinstance(unit, STARTING) or unit.dest_entity_id.value != self._ends.here:
            raise UnitError("begins no transaction")
        if unit.source_entity_id.value != self._ends.there:
            raise UnitError(f"entity {unit.source_entity_id.value} is not known")
        if unit.transmission_mode != TransmissionMode.ACKNOWLEDGED:
            raise UnitError("class 1")
        if isinstance(unit, MetadataPdu):
            self._named(unit)
        self._file = _File(key=transaction_of(unit), last_ns=now_ns)
        return self._file

    def _ask_for_metadata(self, file: _File, unit: GenericPduPacket, now_ns: int) -> None:
        """Ask for what must come first; the library loses count of data that come before it.

        What is not used here is asked for again once the end is announced, and it will be, since
        it is not acknowledged now.
        """
        if file.asked_ns is not None and now_ns - file.asked_ns < TIMER_S * 1e9:
            return
        file.asked_ns = now_ns
        self._reply(NakPdu(towards_sender(unit), 0, 0, segment_requests=[(0, 0)]))

    def _named(self, unit: MetadataPdu) -> Path:
        """Return where a file is to go."""
        if not unit.dest_file_name or unit.source_file_name is None:
            raise UnitError("no file")
        path = confined(self._directory, unit.dest_file_name)
        if path.is_dir() or not path.parent.is_dir():
            raise UnitError(f"{unit.dest_file_name}: no place for a file")
        return path

    def _with_own_name(self, file: _File, unit: MetadataPdu) -> MetadataPdu:
        file.name = str(self._named(unit).relative_to(self._directory.resolve()))
        file.checksum_type = unit.checksum_type
        return renamed(unit, file.partial)

    def _feed(self, unit: GenericPduPacket | None) -> None:
        file = self._file
        try:
            self._handler.state_machine(unit)
            if file is not None and not file.started:
                # the library's default is one list of lost segments for all there ever are
                file.started = True
                tracker = LostSegmentTracker()  # type: ignore[no-untyped-call]
                self._handler._params.acked_params.lost_seg_tracker = tracker  # noqa: SLF001
        except REFUSALS as error:
            if file is not None and (isinstance(error, OSError | ValueError | AssertionError)):
                self._abandon(file, str(error) or type(error).__name__)
        while (holder := self._handler.get_next_packet()) is not None:
            self._reply(holder.pdu)
        if self._handler.state == CfdpState.IDLE and self._file is file:
            self._file = None
            if file is not None and not file.over:
                self._finish(file, ConditionCode.CANCEL_REQUEST_RECEIVED, "abandoned")

    def _reply(self, unit: GenericPduPacket | None) -> None:
        reply = packed(PduHolder(unit))
        if reply is not None:
            self._replies.append(reply)

    def _note_end(self, params: TransactionFinishedParams) -> None:
        """Judge the file before its end is told; what is set here is what goes out."""
        file, outcome = self._file, params.finished_params
        if file is None or file.over:
            return
        if is_good(outcome) and not self._has_its_checksum(file):
            outcome.condition_code = ConditionCode.FILE_CHECKSUM_FAILURE
            outcome.delivery_code = DeliveryCode.DATA_INCOMPLETE
        if is_good(outcome):
            try:
                (self._directory / file.partial).replace(self._directory / file.name)
            except OSError:
                outcome.condition_code = ConditionCode.FILESTORE_REJECTION
        self._finish(file, outcome.condition_code, "" if is_good(outcome) else _reason(outcome))

    def _has_its_checksum(self, file: _File) -> bool:
        """Compare; the library does not where no segment was lost."""
        if file.end is None or not file.name:
            return False
        if file.checksum_type == ChecksumType.NULL_CHECKSUM:
            return True
        found = self._user.vfs.calculate_checksum(
            file.checksum_type, Path(file.partial), file.end.file_size
        )
        return bool(found == file.end.file_checksum)

    def _finish(self, file: _File, condition: ConditionCode, reason: str) -> None:
        file.over = True
        (self._directory / file.partial).unlink(missing_ok=True)
        text = f"{file.name or 'unnamed'}: {reason}" if reason else file.name
        if reason and condition == ConditionCode.NO_ERROR:
            condition = ConditionCode.CANCEL_REQUEST_RECEIVED
        self.ended.append((file.key, condition, text))

    def _abandon(self, file: _File, reason: str) -> None:
        self._handler.reset()
        while self._handler.get_next_packet() is not None:
            pass
        self._file = None
        if not file.over:
            self._finish(file, ConditionCode.INACTIVITY_DETECTED, reason)


def _reason(outcome: FinishedParams) -> str:
    if outcome.condition_code != ConditionCode.NO_ERROR:
        return str(outcome.condition_code.name)
    return f"{outcome.delivery_code.name}, {outcome.file_status.name}"
