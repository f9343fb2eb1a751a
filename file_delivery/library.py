"""What both directions of file delivery ask of cfdp-py: its settings, and what it may raise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from cfdppy import exceptions as cfdp
from cfdppy.mib import (
    CheckTimerProvider,
    DefaultFaultHandlerBase,
    EntityType,
    IndicationConfig,
    LocalEntityConfig,
    RemoteEntityConfig,
    RemoteEntityConfigTable,
)
from cfdppy.restricted_filestore import RestrictedFilestore
from cfdppy.user import CfdpUserBase, TransactionFinishedParams
from spacepackets.cfdp import ChecksumType, ConditionCode, TransmissionMode
from spacepackets.cfdp.pdu.finished import DeliveryCode, FileStatus, FinishedParams
from spacepackets.countdown import Countdown
from spacepackets.util import ByteFieldU8, UnsignedByteField

from file_delivery.units import UNPARSABLE

DAEMON, GROUND = 1, 2  # entity identifiers
UNIT_BYTES = 1000  # longest unit sent
TIMER_S, TIMER_LIMIT = 2.0, 15
TIMEOUT_S = 60.0  # without a word from the other end; the library itself would wait for ever
REFUSALS = (
    *UNPARSABLE,
    OSError,
    cfdp.NoRemoteEntityConfigFound,
    cfdp.InvalidPduDirection,
    cfdp.InvalidSourceId,
    cfdp.InvalidDestinationId,
    cfdp.InvalidTransactionSeqNum,
    cfdp.InvalidNakPdu,
    cfdp.InvalidPduForSourceHandler,
    cfdp.InvalidPduForDestHandler,
    cfdp.PduIgnoredForSource,
    cfdp.PduIgnoredForDest,
    cfdp.UnretrievedPdusToBeSent,
    cfdp.SourceFileDoesNotExist,
    cfdp.ChecksumNotImplemented,
)


@dataclass(frozen=True, slots=True)
class Pair:
    """The two ends, as this one sees them."""

    here: int
    there: int


class Faults(DefaultFaultHandlerBase):
    """Lets the library cancel what it finds wrong; the transaction's end says why."""

    def _ignored(self, *_arguments: object, **_keywords: object) -> None:
        return

    notice_of_suspension_cb = _ignored
    notice_of_cancellation_cb = _ignored
    abandoned_cb = _ignored
    ignore_cb = _ignored


class CheckTimers(CheckTimerProvider):
    """Timers of transfers without acknowledgement; asked for, though there are none here."""

    def provide_check_timer(
        self,
        local_entity_id: UnsignedByteField,  # noqa: ARG002
        remote_entity_id: UnsignedByteField,  # noqa: ARG002
        entity_type: EntityType,  # noqa: ARG002
    ) -> Countdown:
        """Return a timer."""
        return Countdown.from_seconds(TIMER_S)


class Ends(CfdpUserBase):
    """Passes the end of a transaction on; the library's other indications are of no use here."""

    def __init__(self, directory: Path, ended: Callable[[TransactionFinishedParams], None]) -> None:
        super().__init__(vfs=RestrictedFilestore(directory))
        self._ended = ended

    def transaction_finished_indication(self, params: TransactionFinishedParams) -> None:
        """Pass on."""
        self._ended(params)

    def _ignored(self, *_arguments: object, **_keywords: object) -> None:
        return

    transaction_indication = _ignored
    eof_sent_indication = _ignored
    eof_recv_indication = _ignored
    metadata_recv_indication = _ignored
    file_segment_recv_indication = _ignored
    report_indication = _ignored
    suspended_indication = _ignored
    resumed_indication = _ignored
    fault_indication = _ignored
    abandoned_indication = _ignored


def local_entity(here: int) -> LocalEntityConfig:
    """Return this end's settings."""
    indications = IndicationConfig(
        eof_sent_indication_required=False,
        eof_recv_indication_required=False,
        file_segment_recvd_indication_required=False,
    )
    return LocalEntityConfig(ByteFieldU8(here), indications, Faults())  # type: ignore[no-untyped-call]


def remote_entity(there: int) -> RemoteEntityConfigTable:
    """Return what is held of the other end.

    The modular checksum is the one every implementation must have (727.0-B 4.2.2).
    """
    other = RemoteEntityConfig(
        entity_id=ByteFieldU8(there),
        max_file_segment_len=None,
        max_packet_len=UNIT_BYTES,
        closure_requested=True,
        crc_on_transmission=False,
        default_transmission_mode=TransmissionMode.ACKNOWLEDGED,
        crc_type=ChecksumType.MODULAR,
        positive_ack_timer_interval_seconds=TIMER_S,
        positive_ack_timer_expiration_limit=TIMER_LIMIT,
        nak_timer_interval_seconds=TIMER_S,
        nak_timer_expiration_limit=TIMER_LIMIT,
    )
    return RemoteEntityConfigTable([other])


def is_good(outcome: FinishedParams) -> bool:
    """Whether the file has arrived whole; an end that does not say what it did with it may have."""
    return bool(
        outcome.condition_code == ConditionCode.NO_ERROR
        and outcome.delivery_code == DeliveryCode.DATA_COMPLETE
        and outcome.file_status in (FileStatus.FILE_RETAINED, FileStatus.FILE_STATUS_UNREPORTED)
    )
