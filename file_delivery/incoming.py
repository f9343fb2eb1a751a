"""One incoming file; it gets its final name only when it is complete."""

from collections import deque
from contextlib import suppress
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

from file_delivery.errors import DeliveryError
from file_delivery.library import (
    REFUSALS,
    TIMEOUT_S,
    TIMER_S,
    CheckTimers,
    Ends,
    Folder,
    Pair,
    is_good,
    local_entity,
    reason_of,
    remote_entity,
)
from file_delivery.paths import confined
from file_delivery.transfer import Key, Transfer, TransferOutcome, TransferState
from file_delivery.units import (
    UnitError,
    acknowledgement,
    packed,
    refusal,
    renamed,
    towards_sender,
    transaction_of,
)

PARTIAL = ".incoming-"
REPLIES_LIMIT = 256
STARTING = (MetadataPdu, FileDataPdu, EofPdu)


class Incoming:
    """One incoming file.

    Parameters
    ----------
    directory : folder that receives the file
    first : first received unit of the transaction

    Raises
    ------
    UnitError when the unit cannot begin a transaction, or its entities are not these ends.
    """

    def __init__(self, directory: Path, ends: Pair, first: GenericPduPacket, now_ns: int) -> None:
        if not isinstance(first, STARTING) or first.dest_entity_id.value != ends.here:
            raise UnitError("begins no transaction")
        if first.source_entity_id.value != ends.there:
            raise UnitError(f"entity {first.source_entity_id.value} is not known")
        self.key: Key = transaction_of(first)
        self.last_ns = now_ns  # time of the newest unit
        self.outcome: TransferOutcome | None = None
        self.closed = False  # nothing more is expected, not even an acknowledgement
        self.suspended = False
        self.name = ""  # final name from the metadata; empty before they are received
        self._directory, self._first = directory, first
        self._user = Ends(Folder(directory), self._note_end)
        self._handler = DestHandler(
            local_entity(ends.here), self._user, remote_entity(ends.there), CheckTimers()
        )
        self._replies: deque[bytes] = deque(maxlen=REPLIES_LIMIT)
        self._checksum_type = ChecksumType.NULL_CHECKSUM
        self._end: EofPdu | None = None
        self._requested_ns: int | None = None  # when the metadata were requested
        self._started = False  # the library has received a first unit
        if first.transmission_mode != TransmissionMode.ACKNOWLEDGED:
            self.refuse(ConditionCode.INVALID_TRANSMISSION_MODE, "class 1 is not supported")

    @property
    def transfer(self) -> Transfer:
        """State and progress of the transfer."""
        state = TransferState.SUSPENDED if self.suspended else TransferState.RECEIVING
        size = self._handler.file_size or 0
        return Transfer(self.key, self.name, size, self._handler.progress, state, self.last_ns)

    def take(self, unit: GenericPduPacket, now_ns: int) -> None:
        """Process a unit of this transaction."""
        self.last_ns = now_ns
        if isinstance(unit, MetadataPdu):
            renamed_unit = self._with_own_name(unit)
            if renamed_unit is None:
                return
            unit = renamed_unit
        elif not self.name:
            self._request_metadata(unit, now_ns)
            return
        elif isinstance(unit, EofPdu):
            if self._end is not None:  # its acknowledgement was lost; the library sends it once
                kind, condition = DirectiveType.EOF_PDU, unit.condition_code
                self._reply(acknowledgement(unit, kind, condition, TransactionStatus.ACTIVE))
                return
            self._end = unit
        self._feed(unit)

    def poll(self, limit: int, now_ns: int) -> list[bytes]:
        """Return at most `limit` units to send now; end a transfer that has timed out."""
        if not self.closed and not self.suspended:
            if self._started:
                self._feed(None)
            if now_ns - self.last_ns > TIMEOUT_S * 1e9:
                self.abandon(f"nothing came for {TIMEOUT_S:g} s")
        return [self._replies.popleft() for _ in range(min(limit, len(self._replies)))]

    def refuse(self, condition: ConditionCode, reason: str) -> bytes | None:
        """End the transfer; queue and return the unit with the reason (None: not packable)."""
        self._handler.reset()
        self._finish(condition, reason)
        self.closed = True
        unit = packed(PduHolder(refusal(self._first, condition, self.name, reason)))
        if unit is not None:
            self._replies.append(unit)
            if self.outcome is not None:
                self.outcome.answer = unit
        return unit

    def abandon(self, reason: str) -> None:
        """End the transfer without a report to the other end."""
        self._handler.reset()
        self.closed = True
        self._finish(ConditionCode.INACTIVITY_DETECTED, reason)

    @property
    def _partial(self) -> str:
        """Name of the file until it is complete."""
        return f"{PARTIAL}{self.key[0]}-{self.key[1]}"

    def _request_metadata(self, unit: GenericPduPacket, now_ns: int) -> None:
        """Request the metadata and discard the unit: the library miscounts data before metadata.

        The sender repeats the unit of the end (EOF), because it is not acknowledged here. After it,
        the library requests the discarded data again.
        """
        if self._requested_ns is not None and now_ns - self._requested_ns < TIMER_S * 1e9:
            return
        self._requested_ns = now_ns
        self._reply(NakPdu(towards_sender(unit), 0, 0, segment_requests=[(0, 0)]))

    def _with_own_name(self, unit: MetadataPdu) -> MetadataPdu | None:
        try:
            if not unit.dest_file_name or unit.source_file_name is None:
                raise DeliveryError("FILE_NOT_FOUND", "no file is named")
            path = confined(self._directory, unit.dest_file_name)
            if path.is_dir() or not path.parent.is_dir():
                raise DeliveryError("FILE_NOT_FOUND", "no such folder, or a folder itself")
        except DeliveryError as error:
            self.name = self.name or (unit.dest_file_name or "")
            self.refuse(ConditionCode.FILESTORE_REJECTION, str(error))
            return None
        self.name = str(path.relative_to(self._directory.resolve()))
        self._checksum_type = unit.checksum_type
        return renamed(unit, self._partial)

    def _feed(self, unit: GenericPduPacket | None) -> None:
        try:
            self._handler.state_machine(unit)
            if not self._started:
                # by default, all transfers of the library share one list of lost segments
                self._started = True
                tracker = LostSegmentTracker()  # type: ignore[no-untyped-call]
                self._handler._params.acked_params.lost_seg_tracker = tracker  # noqa: SLF001
        except REFUSALS as error:
            if isinstance(error, OSError):
                text = error.strerror or str(error)
                self.refuse(ConditionCode.FILESTORE_REJECTION, text)
            elif isinstance(error, ValueError | AssertionError):
                self.abandon(str(error) or type(error).__name__)
        while (holder := self._handler.get_next_packet()) is not None:
            self._reply(holder.pdu)
        if self._handler.state == CfdpState.IDLE and not self.closed:
            self.closed = True
            self._finish(ConditionCode.CANCEL_REQUEST_RECEIVED, "abandoned")

    def _reply(self, unit: GenericPduPacket | None) -> None:
        reply = packed(PduHolder(unit))
        if reply is not None:
            self._replies.append(reply)

    def _note_end(self, params: TransactionFinishedParams) -> None:
        """Check the file before its end is reported; the codes set here go to the other end."""
        outcome = params.finished_params
        if self.outcome is not None:
            return
        if is_good(outcome) and not self._has_its_checksum():
            outcome.condition_code = ConditionCode.FILE_CHECKSUM_FAILURE
            outcome.delivery_code = DeliveryCode.DATA_INCOMPLETE
        if is_good(outcome):
            try:
                (self._directory / self._partial).replace(self._directory / self.name)
            except OSError:
                outcome.condition_code = ConditionCode.FILESTORE_REJECTION
        self._finish(outcome.condition_code, _reason(outcome))

    def _has_its_checksum(self) -> bool:
        """Return whether the checksum is right; the library checks only after lost segments."""
        if self._end is None or not self.name:
            return False
        if self._checksum_type == ChecksumType.NULL_CHECKSUM:
            return True
        found = self._user.vfs.calculate_checksum(
            self._checksum_type, Path(self._partial), self._end.file_size
        )
        return bool(found == self._end.file_checksum)

    def _finish(self, condition: ConditionCode, reason: str) -> None:
        if self.outcome is not None:
            return
        with suppress(OSError):  # there is none, or the disk cannot be written any more
            (self._directory / self._partial).unlink()
        text = f"{self.name or 'unnamed'}: {reason}" if reason else self.name
        if reason and condition == ConditionCode.NO_ERROR:
            condition = ConditionCode.CANCEL_REQUEST_RECEIVED
        self.outcome = TransferOutcome(condition, text)


def _reason(outcome: FinishedParams) -> str:
    return "" if is_good(outcome) else reason_of(outcome)
