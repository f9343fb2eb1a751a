"""SDO of CiA 301, expedited: a node's transmit PDOs are read, and written in a safe order.

Pure functions, and dialogues without input or output. The order works with every drive: the PDO is
made invalid, its mapping emptied, filled and counted, and the PDO made valid again.
"""

from collections.abc import Generator, Sequence

from fsw.drivers.wire import PdoMapping

COB_REPLY, COB_REQUEST = 0x580, 0x600  # + node
UPLOAD, ABORT = 0x40, 0x80
DOWNLOADED = 0x60
COMMUNICATION, MAPPING = 0x1800, 0x1A00
INVALID = 1 << 31  # bit of a COB-ID entry: the PDO does not exist
NO_RTR = 1 << 30  # not compared: drives set it on their own
READ_ONLY = 0x06010002
ABSENT = (0x06020000, 0x06090011)  # object, entry
MOST_ENTRIES = 64
FRAME_BYTES = 8
Dialogue = Generator[bytes, bytes, str]  # yields requests, is sent the replies, returns a fault


def download(index: int, sub: int, value: int, size: int) -> bytes:
    """Return the request that writes 1 to 4 bytes."""
    head = bytes((0x23 | (4 - size) << 2,)) + index.to_bytes(2, "little") + bytes((sub,))
    return (head + value.to_bytes(size, "little")).ljust(FRAME_BYTES, b"\0")


def upload(index: int, sub: int) -> bytes:
    """Return the request that reads an entry."""
    return (bytes((UPLOAD,)) + index.to_bytes(2, "little") + bytes((sub,))).ljust(8, b"\0")


def aborted(reply: bytes) -> int:
    """Return the abort code of a reply; 0: the reply is not an abort."""
    return int.from_bytes(reply[4:8], "little") if reply[:1] == bytes((ABORT,)) else 0


def value_of(reply: bytes) -> int | None:
    """Return the value of an answer to `upload`; None: it has none of 1 to 4 bytes."""
    if len(reply) != FRAME_BYTES or reply[0] & 0xE2 != 0x42:
        return None
    size = 4 - (reply[0] >> 2 & 3) if reply[0] & 1 else 4
    return int.from_bytes(reply[4 : 4 + size], "little")


def is_answer(request: bytes, reply: bytes) -> bool:
    """Return whether a reply belongs to a request: same entry, and its kind or an abort."""
    kinds = (ABORT, DOWNLOADED) if request[0] != UPLOAD else (ABORT, *range(0x42, 0x50))
    return len(reply) == FRAME_BYTES and reply[1:4] == request[1:4] and reply[0] in kinds


def compared(pdos: Sequence[PdoMapping]) -> Dialogue:
    """Read the PDOs of a node; return the first difference in words, or nothing."""
    for pdo in pdos:
        communication, mapping = COMMUNICATION + pdo.number - 1, MAPPING + pdo.number - 1
        wanted = [(communication, 1, pdo.cob_id), (communication, 2, pdo.transmission)]
        wanted += [(mapping, 0, len(pdo.entries))]
        wanted += [(mapping, k, own) for k, own in enumerate(pdo.entries, start=1)]
        for index, sub, value in wanted:
            reply = yield upload(index, sub)
            found = value_of(reply)
            at = f"0x{index:04x}:{sub:02x}"
            if found is None:
                return f"{at} cannot be read: abort 0x{aborted(reply):08x}"
            flags = NO_RTR if (index, sub) == (communication, 1) else 0
            if found | flags != value | flags and not (
                sub == 0 and (yield from _are_spare(mapping, len(pdo.entries), found))
            ):
                return f"{at} is 0x{found:x} in the drive and 0x{value:x} in the description"
    return ""


def _are_spare(mapping: int, count: int, found: int) -> Generator[bytes, bytes, bool]:
    """Return whether a mapping of `found` entries has nothing after the first `count`."""
    for k in range(count + 1, min(found, MOST_ENTRIES) + 1):
        if value_of((yield upload(mapping, k))) != 0:
            return False
    return found > count


def written(pdos: Sequence[PdoMapping]) -> Dialogue:
    """Write the PDOs of a node and read them back; return the first fault in words, or nothing."""
    for pdo in pdos:
        communication, mapping = COMMUNICATION + pdo.number - 1, MAPPING + pdo.number - 1
        count = len(pdo.entries)
        steps = [
            (communication, 1, pdo.cob_id | INVALID, 4),
            (communication, 2, pdo.transmission, 1),
            (communication, 3, pdo.inhibit, 2),
            (communication, 5, pdo.event_ms, 2),
            (mapping, 0, 0, 1),
            *((mapping, k, own, 4) for k, own in enumerate(pdo.entries, start=1)),
            (mapping, 0, count, 1),
            (communication, 1, pdo.cob_id & ~INVALID, 4),
        ]
        for index, sub, value, size in steps:
            code = aborted((yield download(index, sub, value, size)))
            if code == READ_ONLY and (index, sub) == (mapping, 0):  # a fixed number of entries
                if value:
                    yield from _filled(mapping, count)
                continue
            may_lack = index == communication and sub in (3, 5) and not value
            if code and not (may_lack and code in ABSENT):
                return f"0x{index:04x}:{sub:02x} cannot be written: abort 0x{code:08x}"
    return (yield from compared(pdos))


def _filled(mapping: int, count: int) -> Generator[bytes, bytes, None]:
    """Write zeros to the entries after the first `count`."""
    found = value_of((yield upload(mapping, 0))) or 0
    for k in range(count + 1, min(found, MOST_ENTRIES) + 1):
        yield download(mapping, k, 0, 4)
