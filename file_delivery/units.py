"""Protocol units of file delivery: parsing, and checks before the library receives a unit.

The library trusts offsets and requests: a request for 4 GB would be prepared in memory, a unit with
a far offset would make a file of that size. So every unit is checked against limits first.
"""

import struct

from spacepackets.cfdp import CfdpLv, ConditionCode, Direction, PduConfig
from spacepackets.cfdp.defs import InvalidCrcError, UnsupportedCfdpVersionError
from spacepackets.cfdp.pdu import (
    AbstractFileDirectiveBase,
    AckPdu,
    DirectiveType,
    EofPdu,
    FileDataPdu,
    FinishedPdu,
    MetadataParams,
    MetadataPdu,
    NakPdu,
    TransactionStatus,
)
from spacepackets.cfdp.pdu.finished import DeliveryCode, FileStatus, FinishedParams
from spacepackets.cfdp.pdu.helper import GenericPduPacket, PduFactory, PduHolder
from spacepackets.cfdp.tlv import FileStoreResponseTlv
from spacepackets.cfdp.tlv.defs import (
    FilestoreActionCode,
    FilestoreResponseStatusCode,
    TlvTypeMissmatchError,
)
from spacepackets.util import ByteFieldU64

UNPARSABLE = (
    ValueError,
    IndexError,
    KeyError,
    TypeError,
    AttributeError,
    AssertionError,
    struct.error,
    InvalidCrcError,
    UnsupportedCfdpVersionError,
    TlvTypeMissmatchError,
)
MESSAGE_BYTES = 96  # most bytes of a reason, and of a name, in a refusal
MAX_REQUESTED_BYTES = 1 << 20  # most bytes of one request for lost data; the rest follows later


class UnitError(Exception):
    """A unit is invalid or beyond the limits and is discarded."""


def parse(raw: bytes, max_file_bytes: int) -> GenericPduPacket:
    """Return the decoded unit. Raises UnitError if it is invalid or beyond the limits."""
    try:
        unit = PduFactory.from_raw(raw)
        if unit is None:
            raise UnitError("no known unit")
        if isinstance(unit, EofPdu):  # the library does not shift it down in its byte
            unit.condition_code = ConditionCode(int(unit.condition_code) >> 4)
        _read_all(unit)
        known = len(unit.pack())
    except UNPARSABLE as error:
        raise UnitError(str(error)) from error
    if known != unit.packet_len:
        raise UnitError(f"{unit.packet_len} bytes announced, {known} of them are fields")
    if isinstance(unit, FileDataPdu):
        size = unit.offset + len(unit.file_data)
    else:
        size = unit.file_size if isinstance(unit, EofPdu) else 0  # metadata: `FileEntity` checks
    if (size or 0) > max_file_bytes:
        raise UnitError(f"a file of {size} bytes; at most {max_file_bytes}")
    return unit


def _read_all(unit: GenericPduPacket) -> None:
    """Read every field that the library decodes lazily, so that its errors are raised here."""
    _ = unit.transaction_seq_num.value, unit.source_entity_id.value, unit.dest_entity_id.value
    if isinstance(unit, MetadataPdu):
        _ = unit.source_file_name, unit.dest_file_name, unit.checksum_type


def packed(holder: PduHolder) -> bytes | None:
    """Return a unit as bytes; None if there is none or it cannot be packed.

    The `pack` method of the library's holder is deprecated.
    """
    try:
        return bytes(holder.pdu.pack()) if holder.pdu is not None else None
    except UNPARSABLE:
        return None


def is_for_sender(unit: GenericPduPacket) -> bool:
    """Return whether a unit is directed to the sender of its file (CCSDS 727.0-B 4.5.3)."""
    return bool(unit.direction == Direction.TOWARDS_SENDER)


def transaction_of(unit: GenericPduPacket) -> tuple[int, int]:
    """Return the key of a unit's transaction: source entity and transaction number."""
    return unit.source_entity_id.value, unit.transaction_seq_num.value


def is_number_of(unit: GenericPduPacket, key: tuple[int, int]) -> bool:
    """Return whether a unit answers the transaction `key` of this end.

    LibreCube's receiver answers with the lowest octet of the number only. Successive numbers differ
    in this octet.
    """
    field = unit.transaction_seq_num
    mask = (1 << 8 * field.byte_len) - 1
    return bool(unit.source_entity_id.value == key[0] and field.value == key[1] & mask)


def with_number(unit: GenericPduPacket, number: int) -> GenericPduPacket:
    """Set the full transaction number in an answer and return the answer."""
    unit.pdu_header.pdu_conf.transaction_seq_num = ByteFieldU64(number)
    return unit


def directive(unit: GenericPduPacket) -> DirectiveType | None:
    """Return the kind of a directive; None for file data."""
    return unit.directive_type if isinstance(unit, AbstractFileDirectiveBase) else None


def renamed(unit: MetadataPdu, name: str) -> MetadataPdu:
    """Return the metadata with another name of the destination file."""
    params = MetadataParams(
        closure_requested=unit.closure_requested,
        checksum_type=unit.checksum_type,
        file_size=unit.file_size,
        source_file_name=unit.source_file_name,
        dest_file_name=name,
    )
    return MetadataPdu(pdu_conf=unit.pdu_header.pdu_conf, params=params)


def checked_request(unit: NakPdu, file_size: int) -> NakPdu:
    """Return a request for lost data, cut to `MAX_REQUESTED_BYTES`.

    Raises
    ------
    UnitError when bytes beyond the file are requested.
    """
    left = MAX_REQUESTED_BYTES
    taken: list[tuple[int, int]] = []
    for start, end in unit.segment_requests:
        if not 0 <= start <= end <= file_size:
            raise UnitError(f"bytes {start} to {end} requested; the file has {file_size}")
        if (start, end) == (0, 0):
            taken.append((0, 0))
        elif left > 0:
            size = min(end - start, left)
            taken.append((start, start + size))
            left -= size
    conf = unit.pdu_header.pdu_conf
    return NakPdu(conf, unit.start_of_scope, unit.end_of_scope, segment_requests=taken)


def refusal(
    unit: GenericPduPacket, condition: ConditionCode, name: str, reason: str
) -> FinishedPdu:
    """Return the unit that ends a transaction from the receiving end, with a reason in words."""
    message = CfdpLv(reason.encode()[:MESSAGE_BYTES])
    response = FileStoreResponseTlv(
        FilestoreActionCode.CREATE_FILE_SNM,
        FilestoreResponseStatusCode.CREATE_NOT_ALLOWED,
        name.encode("ascii", "replace")[:MESSAGE_BYTES].decode(),
        filestore_msg=message,
    )
    rejected = condition == ConditionCode.FILESTORE_REJECTION
    params = FinishedParams(
        condition_code=condition,
        delivery_code=DeliveryCode.DATA_INCOMPLETE,
        file_status=FileStatus.DISCARDED_FILESTORE_REJECTION
        if rejected
        else FileStatus.DISCARDED_DELIBERATELY,
        file_store_responses=[response],
    )
    return FinishedPdu(towards_sender(unit), params)


def needs_answer(unit: GenericPduPacket) -> bool:
    """Return whether the sender of a unit waits for the report of the transaction's end."""
    return isinstance(unit, MetadataPdu | EofPdu)


def late_acknowledgement(unit: GenericPduPacket, condition: ConditionCode) -> AckPdu | None:
    """Return the acknowledgement of a unit whose transaction has ended; None if it needs none.

    Source: CCSDS 727.0-B 4.7.2.
    """
    kind = directive(unit)
    if kind not in (DirectiveType.EOF_PDU, DirectiveType.FINISHED_PDU):
        return None
    return acknowledgement(unit, kind, condition, TransactionStatus.TERMINATED)


def acknowledgement(
    unit: GenericPduPacket,
    kind: DirectiveType,
    condition: ConditionCode,
    status: TransactionStatus,
) -> AckPdu:
    """Return an acknowledgement within the transaction of a unit; AckPdu sets the direction."""
    return AckPdu(towards_sender(unit), kind, condition, status)


def towards_sender(unit: GenericPduPacket) -> PduConfig:
    """Return the header settings of an answer to the sender of a unit's file."""
    old = unit.pdu_header.pdu_conf
    return PduConfig(
        source_entity_id=old.source_entity_id,
        dest_entity_id=old.dest_entity_id,
        transaction_seq_num=old.transaction_seq_num,
        trans_mode=old.trans_mode,
        direction=Direction.TOWARDS_SENDER,
    )
