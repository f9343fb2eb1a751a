"""Files to and from the daemon: CFDP class 2 over the link's own packets."""

from __future__ import annotations

import math
import secrets
import shutil
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from spacepackets.ccsds.spacepacket import PacketType, SpacePacket, SpacePacketHeader

from file_delivery.entity import FileEntity
from file_delivery.library import DAEMON, GROUND, Pair
from ground.commands import Catalogue
from ground.errors import FAILED, NO_ANSWER, GroundError, UsageError
from ground.link import COUNT_14, Link
from ground.telemetry import FILE_APID, HEADER_BYTES, Decoder, Sample, apid
from ground.verification import EXIT_CODES, Outcome, follow

DELIVERED = "files"  # the daemon's folder that file delivery works in
LOOK_S = 0.02
CONFIRM_S = 10.0  # after the file is whole, for the daemon to know it
COMPLETED = "completion_success"
ENDS = Pair(here=GROUND, there=DAEMON)
Progress = Callable[[str], None]


class Delivery:
    """Gets and puts files over one link.

    Parameters
    ----------
    timeout_s : for a whole transfer
    tell : what an operator may like to know
    """

    def __init__(
        self, link: Link, catalogue: Catalogue, decoder: Decoder, timeout_s: float, tell: Progress
    ) -> None:
        self._link, self._catalogue, self._decoder = link, catalogue, decoder
        self._timeout_s, self._tell = timeout_s, tell
        self._count = 0

    def get(self, remote: str, local: Path) -> int:
        """Fetch a file and compare its CRC; return its size [B]. Raises GroundError."""
        facts = self.attributes(remote)
        with TemporaryDirectory(dir=local.parent, prefix=".ground-") as folder:
            entity = FileEntity(Path(folder), ends=ENDS)
            packet = self._catalogue.build(
                "DOWNLINK_FILE", {"path": remote, "remove": "NO"}, self._link.next_sequence()
            )
            self._link.send(packet)
            self._carry(entity, packet)
            (found,) = Path(folder).iterdir()
            data = found.read_bytes()
            if len(data) != facts["size_bytes"]:
                raise GroundError(f"{remote}: {len(data)} of {facts['size_bytes']} bytes", FAILED)
            if facts["crc32"] not in (0, zlib.crc32(data)):  # 0: too large to be checked there
                raise GroundError(f"{remote}: the CRC differs; it may have changed", FAILED)
            found.replace(local)
        return len(data)

    def put(self, local: Path, remote: str) -> int:
        """Send a file to the daemon's delivery folder; return its size [B]. Raises GroundError."""
        name = remote.removeprefix(f"{DELIVERED}/")
        if not local.is_file():
            raise UsageError(f"{local}: no such file")
        with TemporaryDirectory(prefix="ground-") as folder:
            copy = Path(folder) / "file"
            shutil.copyfile(local, copy)
            entity = FileEntity(Path(folder), secrets.randbelow(1 << 8), ends=ENDS)
            entity.send(Path("file"), remove=False, name=name)
            self._carry(entity, None)
            data = copy.read_bytes()
        facts = self.attributes(f"{DELIVERED}/{name}")
        if (facts["size_bytes"], facts["crc32"]) != (len(data), zlib.crc32(data)):
            raise GroundError(f"{remote}: not what was sent", FAILED)
        return len(data)

    def attributes(self, remote: str) -> dict[str, int]:
        """Return size and CRC of a file there. Raises GroundError."""
        (sample,) = self.ask("REPORT_FILE_ATTRIBUTES", path=remote)
        return {name: int(sample.values[name]) for name in ("size_bytes", "crc32")}

    def ask(self, name: str, **given: str) -> list[Sample]:
        """Send a command that is answered; return the answers. Raises GroundError."""
        packet = self._catalogue.build(name, given, self._link.next_sequence())
        for verification, sample in follow(self._link, self._decoder, packet, self._timeout_s):
            if sample is None and verification.outcome is not Outcome.COMPLETED:
                last = verification.reports[-1].values if verification.reports else {}
                reason = last.get("error", "")
                text = f"{name} {given}: {verification.outcome} {reason}".strip()
                raise GroundError(text, EXIT_CODES[verification.outcome])
        return [s for s in verification.answers if s.service == packet[7]]

    def _carry(self, entity: FileEntity, request: bytes | None) -> None:
        """Carry units both ways until the transfer is over. Raises GroundError."""
        start_s = told_s = time.monotonic()
        words = (request[:2], request[2:4]) if request is not None else None
        confirmed, whole_s = words is None, math.inf
        while (now_s := time.monotonic()) - start_s < self._timeout_s:
            self._send_units(entity)
            for raw in self._link.packets(now_s + LOOK_S):
                if apid(raw) == FILE_APID:
                    entity.receive(raw[HEADER_BYTES:], round(time.monotonic() * 1e9))
                elif words is not None:
                    confirmed |= self._ends(raw, words)
            for _, good, text in entity.finished():
                if not good:
                    self._send_units(entity)
                    raise GroundError(text, FAILED)
                whole_s = time.monotonic()
            if confirmed and whole_s < math.inf:
                self._send_units(entity)  # the last acknowledgement
                return
            if now_s - whole_s > CONFIRM_S:
                self._tell("the file is here; the daemon has not heard so")
                return
            if now_s - told_s > 1.0:
                told_s = now_s
                counters = entity.counters()
                self._tell(f"{counters['pdus_received']} units in, {counters['pdus_sent']} out")
        raise GroundError(f"not over after {self._timeout_s:g} s", NO_ANSWER)

    def _send_units(self, entity: FileEntity) -> None:
        for unit in entity.poll(round(time.monotonic() * 1e9)):
            self._link.send(self._wrapped(unit))

    def _ends(self, raw: bytes, words: tuple[bytes, bytes]) -> bool:
        """Whether the request to send a file is completed. Raises GroundError when refused."""
        sample = self._decoder.decode(raw)
        if sample.service != 1:
            return False
        named = (sample.values["request_packet_id"], sample.values["request_sequence"])
        if named != tuple(int.from_bytes(word, "big") for word in words):
            return False
        if "error" in sample.values:
            code = EXIT_CODES[Outcome.REJECTED if sample.subtype == 2 else Outcome.FAILED]
            raise GroundError(f"DOWNLINK_FILE: {sample.values['error']}", code)
        return sample.packet == COMPLETED

    def _wrapped(self, unit: bytes) -> bytes:
        """Return a unit in a packet: no secondary header, no CRC."""
        self._count = (self._count + 1) % COUNT_14
        header = SpacePacketHeader(
            packet_type=PacketType.TC,
            apid=FILE_APID,
            seq_count=self._count,
            data_len=len(unit) - 1,
            sec_header_flag=False,
        )
        return bytes(SpacePacket(header, b"", unit).pack())
