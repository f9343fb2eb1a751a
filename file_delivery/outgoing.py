"""One outgoing file."""

from collections import deque
from pathlib import Path

from cfdppy.handler.source import SourceHandler
from cfdppy.request import PutRequest
from cfdppy.user import TransactionFinishedParams
from spacepackets.cfdp import ConditionCode, PduConfig, TransmissionMode
from spacepackets.cfdp.pdu import DirectiveType, EofPdu, FinishedPdu, NakPdu, TransactionStatus
from spacepackets.cfdp.pdu.helper import GenericPduPacket, PduHolder
from spacepackets.seqcount import SeqCountProvider
from spacepackets.util import ByteFieldU8, ByteFieldU64

from file_delivery.library import (
    REFUSALS,
    TIMEOUT_S,
    CheckTimers,
    Ends,
    Pair,
    PieceOfFile,
    is_good,
    local_entity,
    reason_of,
    remote_entity,
)
from file_delivery.transfer import Key, Transfer, TransferOutcome, TransferState
from file_delivery.units import acknowledgement, checked_request, packed, with_number

INBOUND_LIMIT = 256  # units that wait for the state machine


class _Numbered(SourceHandler):
    """The library's sender with a transaction number of 64 bits instead of 32."""

    def __init__(self, ends: Pair, user: Ends, number: int) -> None:
        here, there = local_entity(ends.here), remote_entity(ends.there)
        super().__init__(here, user, there, CheckTimers(), SeqCountProvider(32))
        self._number = number

    def _get_next_transfer_seq_num(self) -> None:
        self._params.pdu_conf.transaction_seq_num = ByteFieldU64(self._number)


class Outgoing:
    """One outgoing file, or a piece of a file.

    Parameters
    ----------
    name : file name at the other end
    piece : offset and size [B] of the part to send; None: the whole file
    remove : whether to remove the local file once it has arrived
    """

    def __init__(
        self,
        ends: Pair,
        number: int,
        path: Path,
        name: str,
        piece: tuple[int, int] | None,
        *,
        remove: bool,
    ) -> None:
        offset, size = piece if piece is not None else (0, path.stat().st_size)
        self.key: Key = (ends.here, number)
        self.last_ns = 0  # time of the newest unit from the other end, or of new data sent
        self.outcome: TransferOutcome | None = None
        self.suspended = False
        self._ends, self._path, self._name, self._remove = ends, path, name, remove
        self._size, self._started = size, False
        user = Ends(PieceOfFile(path, offset, size), self._note_end)
        self._handler = _Numbered(ends, user, number)
        self._inbound: deque[GenericPduPacket] = deque(maxlen=INBOUND_LIMIT)
        self._last_words: deque[bytes] = deque()
        self._drained = False

    @property
    def transfer(self) -> Transfer:
        """State and progress of the transfer."""
        state = TransferState.SENDING if self._started else TransferState.WAITING
        if self.suspended:
            state = TransferState.SUSPENDED
        done = self._handler.progress
        return Transfer(self.key, self._path.name, self._size, done, state, self.last_ns)

    def begin(self, now_ns: int) -> None:
        """Start the transaction."""
        self.last_ns, self._started = now_ns, True
        request = PutRequest(
            destination_id=ByteFieldU8(self._ends.there),
            source_file=Path(self._path.name),
            dest_file=Path(self._name),
            trans_mode=TransmissionMode.ACKNOWLEDGED,
            closure_requested=True,
        )
        try:
            self._handler.put_request(request)
        except REFUSALS as error:  # the file was removed while it waited
            self.give_up(str(error))

    def answer(self, unit: GenericPduPacket, now_ns: int) -> None:
        """Process a unit of the other end. Raises UnitError if it requests data beyond the file."""
        unit = with_number(unit, self.key[1])
        if isinstance(unit, NakPdu):
            unit = checked_request(unit, self._size)
        self.last_ns = now_ns
        if isinstance(unit, FinishedPdu):
            if not is_good(unit.finished_params):  # the library ignores it in some states
                self._refused(unit)
                return
            # the unit shows that EOF was received, in case the acknowledgement of EOF was lost
            self._inbound.append(
                acknowledgement(
                    unit, DirectiveType.EOF_PDU, unit.condition_code, TransactionStatus.ACTIVE
                )
            )
        self._inbound.append(unit)

    def pump(self, limit: int, now_ns: int) -> list[bytes]:
        """Return at most `limit` units to send now; end a transfer that has timed out."""
        units = [self._last_words.popleft() for _ in range(min(limit, len(self._last_words)))]
        handler = self._handler
        while not self.suspended and len(units) < limit:
            holder = handler.get_next_packet()
            if holder is not None:
                unit_bytes = packed(holder)
                if unit_bytes is not None:
                    units.append(unit_bytes)
                continue
            if self.outcome is not None:
                self._drained = True  # its last acknowledgement is sent
                break
            progress = handler.progress
            unit = self._inbound.popleft() if self._inbound else None
            try:
                handler.state_machine(unit)
            except REFUSALS as error:
                if isinstance(error, OSError):
                    self.give_up(error.strerror or str(error))
            if handler.progress != progress:
                self.last_ns = now_ns
            if unit is None and not handler.packets_ready:
                break
        silent = self.outcome is None and not self.suspended
        if silent and now_ns - self.last_ns > TIMEOUT_S * 1e9:
            self.give_up(f"no answer for {TIMEOUT_S:g} s")
        return units

    @property
    def closed(self) -> bool:
        """Whether the transfer has ended and no unit is left to send."""
        return self._drained and not self._last_words

    def cancel(self, reason: str) -> None:
        """End the transfer and report this to the other end."""
        if self._started and self.outcome is None:
            conf: PduConfig = self._handler.pdu_conf
            condition = ConditionCode.CANCEL_REQUEST_RECEIVED
            end = EofPdu(conf, bytes(4), self._handler.progress, condition_code=condition)
            unit = packed(PduHolder(end))
            if unit is not None and self._handler.transaction_id is not None:
                self._last_words.append(unit)
        self._handler.reset()
        self._end(ConditionCode.CANCEL_REQUEST_RECEIVED, reason)

    def give_up(self, reason: str) -> None:
        """End the transfer without a report to the other end."""
        self._handler.reset()
        self._end(ConditionCode.INACTIVITY_DETECTED, reason)

    def _refused(self, unit: FinishedPdu) -> None:
        status, kind = TransactionStatus.TERMINATED, DirectiveType.FINISHED_PDU
        words = packed(PduHolder(acknowledgement(unit, kind, unit.condition_code, status)))
        if words is not None:
            self._last_words.append(words)
        self._handler.reset()
        self._end(ConditionCode.CANCEL_REQUEST_RECEIVED, reason_of(unit.finished_params))

    def _note_end(self, params: TransactionFinishedParams) -> None:
        outcome = params.finished_params
        if is_good(outcome):
            self._end(ConditionCode.NO_ERROR, "")
        else:
            self._end(ConditionCode.CANCEL_REQUEST_RECEIVED, reason_of(outcome))

    def _end(self, condition: ConditionCode, reason: str) -> None:
        if self.outcome is not None:
            return
        self.suspended = False
        text = f"{self._path.name}: {reason}" if reason else self._path.name
        self.outcome = TransferOutcome(condition, text)
        if self._remove and self.outcome.is_good:
            try:
                self._path.unlink(missing_ok=True)
            except OSError as error:
                self.outcome = TransferOutcome(condition, f"{text}: stays: {error.strerror}")
