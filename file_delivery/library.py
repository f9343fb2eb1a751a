"""Settings, file access and errors of cfdp-py, for both directions of file delivery."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from cfdppy import exceptions as cfdp
from cfdppy.filestore import NativeFilestore
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
UNIT_BYTES = 976  # longest unit sent: its packet fits an authenticated frame (at most 987 bytes)
TIMER_S, TIMER_LIMIT = 2.0, 15
CHECKSUM_BYTES = 1 << 20  # summed at a time; a multiple of 4
TIMEOUT_S = 60.0  # longest time without a unit of the other end; the library has no such limit
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
    """Entity identifiers of this end (`here`) and of the other end (`there`)."""

    here: int
    there: int


class Faults(DefaultFaultHandlerBase):
    """Ignores the library's fault callbacks; the report of a transaction's end has the reason."""

    def _ignored(self, *_arguments: object, **_keywords: object) -> None:
        return

    notice_of_suspension_cb = _ignored
    notice_of_cancellation_cb = _ignored
    abandoned_cb = _ignored
    ignore_cb = _ignored


class CheckTimers(CheckTimerProvider):
    """Timers that the library requires for unacknowledged transfers, which are never used here."""

    def provide_check_timer(
        self,
        local_entity_id: UnsignedByteField,  # noqa: ARG002
        remote_entity_id: UnsignedByteField,  # noqa: ARG002
        entity_type: EntityType,  # noqa: ARG002
    ) -> Countdown:
        """Return a timer of `TIMER_S`."""
        return Countdown.from_seconds(TIMER_S)


class Folder(RestrictedFilestore):
    """The folder that receives files."""

    def calculate_checksum(
        self,
        checksum_type: ChecksumType,
        file_path: Path,
        size_to_verify: int,
        segment_len: int = 0,
    ) -> bytes:
        """Return a file's checksum; a modular one is faster here than in the library."""
        if checksum_type == ChecksumType.MODULAR:
            return modular_checksum(self.restricted_path / file_path, 0, None)
        return super().calculate_checksum(
            checksum_type, file_path, size_to_verify, segment_len or CHECKSUM_BYTES
        )


class PieceOfFile(NativeFilestore):
    """One file, or a piece of it, presented to the library as a whole file.

    Parameters
    ----------
    offset, size : offset and size of the piece in the file [B]
    """

    def __init__(self, path: Path, offset: int, size: int) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self._path, self._offset, self._size = path, offset, size

    def file_exists(self, path: Path) -> bool:  # noqa: ARG002
        """Return whether the file still exists."""
        return self._path.is_file()

    def file_size(self, file: Path) -> int:  # noqa: ARG002
        """Return the size of the piece [B]."""
        return self._size

    def read_data(self, file: Path, offset: int | None, read_len: int | None = None) -> bytes:  # noqa: ARG002
        """Return `read_len` bytes from `offset` within the piece; None: to its end."""
        start = offset or 0
        length = self._size - start if read_len is None else min(read_len, self._size - start)
        return super().read_data(self._path, self._offset + start, length)

    def calculate_checksum(
        self,
        checksum_type: ChecksumType,
        file_path: Path,  # noqa: ARG002
        size_to_verify: int,
        segment_len: int = 0,  # noqa: ARG002
    ) -> bytes:
        """Return the checksum of the first `size_to_verify` bytes. Raises ValueError."""
        if checksum_type != ChecksumType.MODULAR:
            raise ValueError(f"{checksum_type.name}: not sent")
        return modular_checksum(self._path, self._offset, size_to_verify)


def modular_checksum(path: Path, offset: int, size: int | None) -> bytes:
    """Return the sum of the 32-bit words of a piece of a file (727.0-B 4.2.2). Raises OSError.

    Parameters
    ----------
    offset, size : offset and size of the piece [B]; size None: to the end of the file
    """
    total = 0
    with path.open("rb") as file:
        file.seek(offset)
        left = path.stat().st_size - offset if size is None else size
        while data := file.read(min(CHECKSUM_BYTES, left)):
            left -= len(data)
            words = np.frombuffer(data + bytes(-len(data) % 4), ">u4")
            total += int(words.sum(dtype=np.uint64))
    return (total & 0xFFFFFFFF).to_bytes(4, "big")


class Ends(CfdpUserBase):
    """Passes the end of a transaction to `ended`; ignores the library's other indications."""

    def __init__(
        self, files: NativeFilestore, ended: Callable[[TransactionFinishedParams], None]
    ) -> None:
        super().__init__(vfs=files)
        self._ended = ended

    def transaction_finished_indication(self, params: TransactionFinishedParams) -> None:
        """Pass the parameters of the end to `ended`."""
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
    """Return the library's settings of this end."""
    indications = IndicationConfig(
        eof_sent_indication_required=False,
        eof_recv_indication_required=False,
        file_segment_recvd_indication_required=False,
    )
    return LocalEntityConfig(ByteFieldU8(here), indications, Faults())  # type: ignore[no-untyped-call]


def remote_entity(there: int) -> RemoteEntityConfigTable:
    """Return the library's settings of the other end.

    Every implementation must support the modular checksum (727.0-B 4.2.2).
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
    """Return whether the file has arrived complete; an unreported file status counts as good."""
    return bool(
        outcome.condition_code == ConditionCode.NO_ERROR
        and outcome.delivery_code == DeliveryCode.DATA_COMPLETE
        and outcome.file_status in (FileStatus.FILE_RETAINED, FileStatus.FILE_STATUS_UNREPORTED)
    )


def reason_of(outcome: FinishedParams) -> str:
    """Return why a file has not arrived: the protocol's code and the other end's message."""
    word = str(outcome.condition_code.name)
    if outcome.condition_code == ConditionCode.NO_ERROR:
        word = f"{outcome.delivery_code.name}, {outcome.file_status.name}"
    own = [item.filestore_msg.value for item in outcome.file_store_responses or ()]
    return ": ".join([word, *(text.decode("utf-8", "replace") for text in own if text)])
