"""Units of a file as a ground sends them, and two ends with a link."""

import zlib
from pathlib import Path

import numpy as np
from spacepackets.cfdp import (
    ChecksumType,
    PduConfig,
    TransmissionMode,
)
from spacepackets.cfdp.pdu import (
    EofPdu,
    FileDataPdu,
    MetadataParams,
    MetadataPdu,
)
from spacepackets.cfdp.pdu.file_data import FileDataParams
from spacepackets.util import ByteFieldU8, ByteFieldU16

from file_delivery.entity import FileEntity
from file_delivery.library import DAEMON, GROUND, Pair

S = 1_000_000_000


class Uplink:
    """Units of one file as a ground would send them, made by hand."""

    def __init__(self, content: bytes, name: str = "up.bin", number: int = 7) -> None:
        self.content, self.name, self.number = content, name, number
        self.checksum_type = ChecksumType.CRC_32
        self.checksum = zlib.crc32(content).to_bytes(4, "big")
        self.source, self.size = GROUND, len(content)
        self.mode = TransmissionMode.ACKNOWLEDGED

    @property
    def conf(self) -> PduConfig:
        return PduConfig(
            source_entity_id=ByteFieldU8(self.source),
            dest_entity_id=ByteFieldU8(DAEMON),
            transaction_seq_num=ByteFieldU16(self.number),
            trans_mode=self.mode,
        )

    def metadata(self) -> bytes:
        params = MetadataParams(
            closure_requested=True,
            checksum_type=self.checksum_type,
            file_size=self.size,
            source_file_name="anything",
            dest_file_name=self.name,
        )
        return bytes(MetadataPdu(self.conf, params).pack())

    def data(self, start: int = 0, end: int | None = None) -> bytes:
        piece = self.content[start:end]
        return bytes(FileDataPdu(self.conf, FileDataParams(piece, start)).pack())

    def end(self) -> bytes:
        return bytes(EofPdu(self.conf, self.checksum, self.size).pack())


def drain(entity: FileEntity, now_ns: int = 0) -> list[bytes]:
    found: list[bytes] = []
    while units := entity.poll(now_ns):
        found += units
    return found


def content(size: int, seed: int = 1) -> bytes:
    return np.random.default_rng(seed).bytes(size)


def leftovers(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.rglob("*"))


def pair(tmp_path: Path) -> tuple[FileEntity, FileEntity]:
    for name in ("daemon", "ground"):
        (tmp_path / name).mkdir(exist_ok=True)
    ends = Pair(here=GROUND, there=DAEMON)
    return FileEntity(tmp_path / "daemon"), FileEntity(tmp_path / "ground", ends=ends)


def carry(daemon: FileEntity, ground: FileEntity, now_ns: int = 0) -> None:
    """Carry units both ways until both are silent."""
    while True:
        down, up = daemon.poll(now_ns), ground.poll(now_ns)
        for unit in down:
            ground.receive(unit, now_ns)
        for unit in up:
            daemon.receive(unit, now_ns)
        if not down and not up:
            return
