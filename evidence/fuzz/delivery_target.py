"""Target of file delivery: units of CCSDS 727.0-B to an entity that receives and sends files."""

import os
import shutil
import tempfile
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path

from spacepackets.cfdp import ChecksumType
from spacepackets.cfdp.pdu import EofPdu, FileDataPdu, MetadataPdu
from spacepackets.cfdp.pdu.helper import PduHolder

from evidence.fuzz.oracle import SEALED, OracleError, Target, require, segments
from file_delivery.entity import RECEIVING_LIMIT, FileEntity
from file_delivery.incoming import PARTIAL
from file_delivery.units import UnitError, packed, parse, transaction_of

MAX_FILE_BYTES = 4096
MAX_LOOKS = 400  # most polls, each of at most 32 units, until the answers to a unit are sent
DAEMON, GROUND = 1, 2
LOOK_NS = 10_000_000
DOWN = Path("down.bin")
DOWN_BYTES = bytes(range(256)) * 6
METADATA, DATA, END, ANY = 0, 1, 2, 3
TOWARDS_SENDER = 0x08


def modular(content: bytes) -> int:
    """Return the modular checksum of CCSDS 727.0-B: the sum of big-endian 32-bit words mod 2^32."""
    padded = content + bytes(-len(content) % 4)
    words = (padded[k : k + 4] for k in range(0, len(padded), 4))
    return sum(int.from_bytes(word, "big") for word in words) & 0xFFFFFFFF


class DeliveryUplink:
    """Encodes consistent units from the ground: the end of a file fits the data sent before."""

    def __init__(self) -> None:
        self._sent: defaultdict[int, bytearray] = defaultdict(bytearray)

    def seal(self, payload: bytes) -> bytes:
        """Return a unit; the first byte of `payload` is kind and transaction, the rest its fields.

        Kinds: metadata, data, end of the data sent so far, any directive in either direction.
        """
        head, body = payload[:1].ljust(1, b"\0")[0], payload[1:]
        kind, number, flags = head & 3, head >> 2 & 3, 0x20
        sent = self._sent[number]
        if kind == DATA:
            offset = 4 * body[0] if body else 0
            piece = body[1:]
            sent.extend(bytes(max(0, offset + len(piece) - len(sent))))
            sent[offset : offset + len(piece)] = piece
            body, flags = offset.to_bytes(4, "big") + piece, flags | 0x10
        elif kind == END:
            words = (modular(bytes(sent)), len(sent))
            body = (
                b"\x04" + body[:1].ljust(1, b"\0") + b"".join(w.to_bytes(4, "big") for w in words)
            )
        elif kind == METADATA:
            body = b"\x07" + body
        elif head & 0x10:  # an answer to the file that the entity sends
            return _unit(flags | TOWARDS_SENDER, body, (DAEMON, 1, GROUND))
        return _unit(flags, body, (GROUND, number, DAEMON))


def _unit(flags: int, body: bytes, ids: tuple[int, int, int]) -> bytes:
    return bytes((flags, *len(body).to_bytes(2, "big"), 0, *ids)) + body


class DeliveryModel:
    """The contents that the received units permit: all bytes sent for each offset, all ends."""

    def __init__(self) -> None:
        self._bytes: dict[tuple[int, int], defaultdict[int, set[int]]] = {}
        self._ends: defaultdict[tuple[int, int], set[tuple[int, int]]] = defaultdict(set)
        self._unchecked: set[tuple[int, int]] = set()

    def take(self, raw: bytes) -> None:
        """Record a unit; require that an accepted unit can be encoded again."""
        try:
            unit = parse(raw, MAX_FILE_BYTES)
        except UnitError:
            return
        require(unit.packet_len <= len(raw), "longer than what came", unit.packet_len, raw)
        again = packed(PduHolder(unit))
        require(again is not None and len(again) == unit.packet_len, "cannot be written", raw)
        if again is not None and again != raw[: len(again)]:  # another encoding of the same unit
            twice = packed(PduHolder(parse(again, MAX_FILE_BYTES)))
            require(twice == again, "not the same again", raw)
        key = transaction_of(unit)
        if isinstance(unit, FileDataPdu):
            places = self._bytes.setdefault(key, defaultdict(set))
            for at, octet in enumerate(unit.file_data, start=unit.offset):
                places[at].add(octet)
        elif isinstance(unit, EofPdu):
            checksum = int.from_bytes(unit.file_checksum, "big")
            self._ends[key].add((unit.file_size, checksum))
        elif isinstance(unit, MetadataPdu) and unit.checksum_type != ChecksumType.MODULAR:
            self._unchecked.add(key)

    def explains(self, content: bytes) -> bool:
        """Return whether the units of one transaction permit this content and its checksum."""
        for key, ends in self._ends.items():
            places: Mapping[int, set[int]] = self._bytes.get(key, {})
            known = all(octet in places.get(at, ()) for at, octet in enumerate(content))
            checked = (len(content), modular(content)) in ends
            loose = key in self._unchecked and any(size == len(content) for size, _ in ends)
            if known and (checked or loose):
                return True
        return False


def delivery_target() -> Target:
    """Return the target of file delivery."""
    memory = Path("/dev/shm")
    home = Path(tempfile.mkdtemp(prefix="fuzz-", dir=memory if memory.is_dir() else None))
    folder = home / "files"

    def one(data: bytes) -> None:
        shutil.rmtree(folder, ignore_errors=True)
        (folder / "sub").mkdir(parents=True)
        (folder / DOWN).write_bytes(DOWN_BYTES)
        entity = FileEntity(folder, lambda: 1, max_file_bytes=MAX_FILE_BYTES)
        entity.send(folder / DOWN, remove=False)
        uplink, model, now_ns, count = DeliveryUplink(), DeliveryModel(), 0, 0
        for op, payload in segments(data):
            raw = uplink.seal(payload) if op & SEALED else payload
            model.take(raw)
            entity.receive(raw, now_ns)
            count += 1
            now_ns = _drain(entity, now_ns)
            _look(entity, folder, model)
        counters = entity.counters()
        require(counters["pdus_received"] == count, "units are lost", counters, count)
        require(counters["pdus_rejected"] <= count, "more refused than came", counters)
        require({path.name for path in home.iterdir()} == {"files"}, "a file elsewhere")
        require((folder / DOWN).is_file(), "what was sent is gone")

    return one


def _drain(entity: FileEntity, now_ns: int) -> int:
    """Poll until nothing is left to send; return the time at the end [ns]."""
    for _ in range(MAX_LOOKS):
        now_ns += LOOK_NS
        if not entity.poll(now_ns):
            return now_ns
    raise OracleError("never silent")


def _look(entity: FileEntity, folder: Path, model: DeliveryModel) -> None:
    """Compare the finished transfers with the received units; check the files in the folder."""
    for number, good, text in entity.finished():
        if number == 0 and good:
            content = (folder / text).read_bytes()
            require(model.explains(content), "not what came", text, content)
    for where, _, names in os.walk(folder):  # `Path.walk` is five times slower
        for name in names:
            path = os.path.join(where, name)
            require(os.stat(path).st_size <= MAX_FILE_BYTES, "too large a file", path)
    partial = [name for name in os.listdir(folder) if name.startswith(PARTIAL)]
    require(len(partial) <= RECEIVING_LIMIT, "too many files begun", partial)
