"""File transfers to and from the daemon over one link: CFDP class 2 in the link's packets."""

import time
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from spacepackets.ccsds.spacepacket import PacketType, SpacePacket, SpacePacketHeader

from file_delivery.entity import FileEntity
from file_delivery.library import DAEMON, GROUND, Pair
from file_delivery.numbers import beginning
from ground.commands import Catalogue
from ground.errors import FAILED, GroundError, LinkError
from ground.link import COUNT_14, Link
from ground.telemetry import FILE_APID, HEADER_BYTES, Sample, TelemetryDecoder, apid
from ground.verification import EXIT_CODES, VerificationOutcome, follow

DELIVERED = "files"  # the daemon's folder that file delivery works in
LOOK_S = 0.02
ANSWER_S = 5.0  # longest wait for the answer to a telecommand
STALL_S = 6.0  # longest time without a unit of a transfer; then the link counts as lost
LINGER_S = 2.0  # longest wait for the last acknowledgements of a complete file
ENDS = Pair(here=GROUND, there=DAEMON)
NOT_ANSWERED = (VerificationOutcome.NO_ANSWER, VerificationOutcome.UNFINISHED)
NOT_FOUND = "FILE_NOT_FOUND"
Progress = Callable[[str], None]


class RefusedError(GroundError):
    """The daemon refused a telecommand, or the telecommand failed; `error` is the reason."""

    def __init__(self, message: str, exit_code: int, error: str) -> None:
        super().__init__(message, exit_code)
        self.error = error


class EndedError(GroundError):
    """The daemon refused the transfer, or it was cancelled here or on board."""

    def __init__(self, message: str) -> None:
        super().__init__(message, FAILED)


@dataclass(frozen=True, slots=True)
class Facts:
    """Size, checksum and modification time of a file."""

    size: int  # [B]
    crc32: int  # 0: not known
    modified_s: float = 0.0


class Delivery:
    """Sends and fetches files, and asks about them, over one link.

    Parameters
    ----------
    timeout_s : longest time for one file or piece [s]
    progress : receives lines of text about the progress
    number : returns the number of a new transaction, never used before
    is_wanted : returns False as soon as the operator has cancelled the transfer
    """

    def __init__(
        self,
        link: Link,
        catalogue: Catalogue,
        decoder: TelemetryDecoder,
        timeout_s: float,
        progress: Progress,
        *,
        number: Callable[[], int] = beginning,
        is_wanted: Callable[[], bool] = lambda: True,
    ) -> None:
        self._link, self._catalogue, self._decoder = link, catalogue, decoder
        self._timeout_s, self._progress, self._number = timeout_s, progress, number
        self._is_wanted = is_wanted
        self._count = 0

    @property
    def is_heard(self) -> bool:
        """Whether the daemon has sent anything on this link."""
        return self._link.is_heard

    def fetch(self, remote: str, offset: int, size: int) -> bytes:
        """Return `size` bytes of a remote file from byte `offset` on. Raises GroundError."""
        token = f"piece-{self._number():x}"
        given = {"path": remote, "offset": str(offset), "size_bytes": str(size), "name": token}
        packet = self._catalogue.build("DOWNLINK_PIECE", given, self._link.next_sequence())
        with TemporaryDirectory(prefix="ground-") as folder:
            entity = FileEntity(Path(folder), ends=ENDS, accepts=lambda name: name == token)
            self._link.send(packet)
            self._carry(entity, f"{remote} from byte {offset}", token, packet)
            data = (Path(folder) / token).read_bytes()
        if len(data) != size:
            raise GroundError(f"{remote}: {len(data)} of {size} bytes", FAILED)
        return data

    def store(self, local: Path, name: str, piece: tuple[int, int] | None = None) -> None:
        """Send a file, or a piece of it, into the daemon's delivery folder. Raises GroundError."""
        with TemporaryDirectory(prefix="ground-") as folder:
            entity = FileEntity(Path(folder), self._number, ends=ENDS, accepts=lambda _name: False)
            entity.send(local, remove=False, name=name, piece=piece)
            self._carry(entity, name, local.name, None)

    def facts(self, remote: str) -> Facts | None:
        """Return the facts of a remote file; None if it does not exist. Raises GroundError."""
        try:
            (sample,) = self.ask("REPORT_FILE_ATTRIBUTES", path=remote)
        except RefusedError as error:
            if error.error == NOT_FOUND:
                return None
            raise
        found: Mapping[str, object] = sample.values
        return Facts(
            int(str(found["size_bytes"])),
            int(str(found["crc32"])),
            float(str(found["modified_s"])),
        )

    def ask(self, name: str, **given: str) -> list[Sample]:
        """Send a telecommand; return its answers of service 23. Raises RefusedError, LinkError."""
        packet = self._catalogue.build(name, given, self._link.next_sequence())
        for verification, sample in follow(self._link, self._decoder, packet, ANSWER_S):
            if sample is not None or verification.outcome is VerificationOutcome.COMPLETED:
                continue
            last = verification.reports[-1].values if verification.reports else {}
            reason = str(last.get("error", ""))
            words = " ".join([name, *given.values()])
            text = f"{words}: {verification.outcome} {reason}".strip()
            if verification.outcome in NOT_ANSWERED:
                raise LinkError(text)
            raise RefusedError(text, EXIT_CODES[verification.outcome], reason)
        return [s for s in verification.answers if s.service == 23]

    def _carry(self, entity: FileEntity, what: str, name: str, request: bytes | None) -> None:
        """Exchange units until the entity's transfer has ended. Raises GroundError.

        Parameters
        ----------
        what : words for the transfer in errors and progress
        name : start of the text with which the entity reports the end
        request : the telecommand that began the transfer; its refusal ends the transfer
        """
        begun_ns = told_ns = time.monotonic_ns()
        try:
            while True:
                now_ns = time.monotonic_ns()
                self._look(entity, request)
                ended = [item for item in entity.finished() if item[2].startswith(name)]
                if ended:
                    _, good, text = ended[0]
                    self._linger(entity)
                    if not good:
                        raise EndedError(text)
                    return
                heard_ns = max([begun_ns, *(t.last_ns for t in entity.transfers())])
                if now_ns - heard_ns > STALL_S * 1e9:
                    raise LinkError(f"{what}: nothing came for {STALL_S:g} s")
                if now_ns - begun_ns > self._timeout_s * 1e9:
                    raise LinkError(f"{what}: not over after {self._timeout_s:g} s")
                if not self._is_wanted():
                    raise EndedError(f"{what}: cancelled")
                if now_ns - told_ns > 1e9:
                    told_ns = now_ns
                    done = sum(t.done for t in entity.transfers())
                    self._progress(f"{what}: {done} bytes")
        except BaseException:
            self._withdraw(entity)
            raise

    def _look(self, entity: FileEntity, request: bytes | None) -> None:
        self._send_units(entity)
        for raw in self._link.packets(time.monotonic() + LOOK_S):
            if apid(raw) == FILE_APID:
                entity.receive(raw[HEADER_BYTES:], time.monotonic_ns())
                self._send_units(entity)
            elif request is not None:
                self._check_refusal(raw, request)

    def _linger(self, entity: FileEntity) -> None:
        """Exchange the last acknowledgements; the transfer is complete even if they are lost."""
        until_s = time.monotonic() + LINGER_S
        while not entity.is_idle and time.monotonic() < until_s:
            self._look(entity, None)
        self._send_units(entity)

    def _withdraw(self, entity: FileEntity) -> None:
        """Cancel this program's transfers, so that the daemon stops sending."""
        for transfer in entity.transfers():
            if transfer.key[0] == GROUND or transfer.name:
                entity.cancel(transfer.key)
        try:
            self._send_units(entity)
        except GroundError:
            return  # the link is lost: the other end times out

    def _send_units(self, entity: FileEntity) -> None:
        for unit in entity.poll(time.monotonic_ns()):
            self._link.send(self._wrapped(unit))

    def _check_refusal(self, raw: bytes, request: bytes) -> None:
        """Raise RefusedError if a packet reports that the request was refused or failed."""
        sample = self._decoder.decode(raw)
        if sample.service != 1 or "error" not in sample.values:
            return
        words = (request[:2], request[2:4])
        named = (sample.values["request_packet_id"], sample.values["request_sequence"])
        if named == tuple(int.from_bytes(word, "big") for word in words):
            outcome = (
                VerificationOutcome.REJECTED if sample.subtype == 2 else VerificationOutcome.FAILED
            )
            error = str(sample.values["error"])
            raise RefusedError(f"the daemon: {error}", EXIT_CODES[outcome], error)

    def _wrapped(self, unit: bytes) -> bytes:
        """Return a unit in a space packet without secondary header and CRC."""
        self._count = (self._count + 1) % COUNT_14
        header = SpacePacketHeader(
            packet_type=PacketType.TC,
            apid=FILE_APID,
            seq_count=self._count,
            data_len=len(unit) - 1,
            sec_header_flag=False,
        )
        return bytes(SpacePacket(header, b"", unit).pack())


def facts_of(path: Path) -> Facts:
    """Return size and CRC of a local file. Raises OSError."""
    size = crc32 = 0
    with path.open("rb") as file:
        while data := file.read(1 << 20):
            size, crc32 = size + len(data), zlib.crc32(data, crc32)
    return Facts(size, crc32)
