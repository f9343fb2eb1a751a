"""Transfers that survive a lost link and a killed program: in pieces, with a record of each.

A complete piece is kept, so an interrupted transfer continues with the next piece. The pieces of an
upload are appended to NAME.ID.part on board, those of a download to .NAME.ID.part here. The file
gets its final name when size and CRC are right.
"""

import json
import secrets
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal, Self

from file_delivery.durable import rename_file, replace_file, sync_file
from ground.delivery import (
    DELIVERED,
    NOT_FOUND,
    Delivery,
    EndedError,
    Facts,
    Progress,
    RefusedError,
    facts_of,
)
from ground.errors import FAILED, REJECTED, GroundError, LinkError, UsageError
from ground.state_folder import made

RETRY_S = 0.5
ATTEMPTS = 4  # to get a file that changes meanwhile
OUT_OF_RANGE = "OUT_OF_RANGE"  # error for a piece that the file no longer has
Connect = Callable[[], AbstractContextManager[Delivery]]


@dataclass(frozen=True, slots=True, kw_only=True)
class TransferRecord:
    """State that a transfer needs to continue after an interruption."""

    id: str
    direction: Literal["get", "put"]
    remote: str
    local: str
    size: int
    crc32: int
    modified_s: float  # modification time of a remote file
    piece_bytes: int
    moving: bool = False  # whether an upload is complete except for its final name

    @property
    def partial(self) -> Path:
        """Local file of the bytes received so far."""
        local = Path(self.local)
        return local.with_name(f".{local.name}.{self.id}.part")

    @property
    def uploaded(self) -> str:
        """Remote name of the file with the bytes uploaded so far."""
        return f"{self.remote}.{self.id}.part"

    @property
    def piece(self) -> str:
        """Remote name of the piece that is being uploaded."""
        return f"{self.remote}.{self.id}.piece"


class SpoiledError(GroundError):
    """The bytes transferred so far cannot be used."""

    def __init__(self, message: str) -> None:
        super().__init__(message, FAILED)


class Records:
    """Records of unfinished transfers, one file each."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def all(self) -> list[TransferRecord]:
        """Return all records that can be read."""
        found = []
        for path in sorted(self._folder.glob("*.json")):
            try:
                found.append(TransferRecord(**json.loads(path.read_text())))
            except (OSError, ValueError, TypeError, RecursionError):
                continue
        return found

    def find(self, name: str) -> TransferRecord:
        """Return the record with this id. Raises UsageError."""
        for record in self.all():
            if record.id == name:
                return record
        raise UsageError(f"{name}: no such transfer; see `ground file transfers`")

    def keep(self, record: TransferRecord) -> None:
        """Write a record; it is on the disk when this returns."""
        made(self._folder)
        replace_file(self._path(record), json.dumps(asdict(record)))

    def holds(self, record: TransferRecord) -> bool:
        """Return whether the record exists: its transfer was neither finished nor cancelled."""
        return self._path(record).exists()

    def remove(self, record: TransferRecord) -> None:
        """Remove a record."""
        self._path(record).unlink(missing_ok=True)

    def _path(self, record: TransferRecord) -> Path:
        return self._folder / f"{record.id}.json"


class ResumableTransfer:
    """One transfer; after an interruption, a second `run` continues it."""

    def __init__(self, record: TransferRecord, records: Records, progress: Progress) -> None:
        self.record, self._records, self._progress = record, records, progress

    @classmethod
    def get(
        cls, remote: str, local: Path, records: Records, progress: Progress, piece_bytes: int
    ) -> Self:
        """Return a new transfer of a remote file to a local path. Raises UsageError."""
        if not local.parent.is_dir() or local.is_dir():
            raise UsageError(f"{local}: no place for a file")
        return cls._begin("get", remote, local, Facts(0, 0), records, progress, piece_bytes)

    @classmethod
    def put(
        cls, remote: str, local: Path, records: Records, progress: Progress, piece_bytes: int
    ) -> Self:
        """Return a new transfer of a local file to the daemon. Raises UsageError."""
        if not local.is_file():
            raise UsageError(f"{local}: no such file")
        name = remote if remote.startswith(f"{DELIVERED}/") else f"{DELIVERED}/{remote}"
        return cls._begin("put", name, local, facts_of(local), records, progress, piece_bytes)

    @classmethod
    def _begin(
        cls,
        direction: Literal["get", "put"],
        remote: str,
        local: Path,
        facts: Facts,
        records: Records,
        progress: Progress,
        piece_bytes: int,
    ) -> Self:
        record = TransferRecord(
            id=secrets.token_hex(3),
            direction=direction,
            remote=remote,
            local=str(local.absolute()),
            **asdict(facts),
            piece_bytes=piece_bytes,
        )
        records.keep(record)
        return cls(record, records, progress)

    def run(self, delivery: Delivery) -> int:
        """Run the transfer to its end; return the size of the file [B].

        Raises
        ------
        LinkError when the transfer can be continued; another GroundError when it has failed.
        """
        if self.record.direction == "put":
            self._put(delivery)
        else:
            self._get_as_it_is(delivery)
        self._records.remove(self.record)
        return self.record.size

    @property
    def is_worth_keeping(self) -> bool:
        """Whether a later run can use the bytes transferred so far."""
        if self.record.direction == "put":
            return self.record.size > self.record.piece_bytes
        partial = self.record.partial
        return partial.exists() and partial.stat().st_size > 0

    def discard(self, delivery: Delivery | None) -> None:
        """Remove the record and the partial files; without `delivery`, those on board stay."""
        self._records.remove(self.record)
        if self.record.direction == "get":
            self.record.partial.unlink(missing_ok=True)
        elif delivery is not None:
            for name in (self.record.uploaded, self.record.piece):
                _delete(delivery, name)

    def _get_as_it_is(self, delivery: Delivery) -> None:
        """Get a file; repeat this for a small file that changes meanwhile, like the status file."""
        for left in reversed(range(ATTEMPTS)):
            try:
                self._get(delivery)
            except (SpoiledError, EndedError, RefusedError) as error:
                is_other = not isinstance(error, RefusedError) or error.error == OUT_OF_RANGE
                is_small = self.record.size <= self.record.piece_bytes
                if not (left and is_other and is_small and self._records.holds(self.record)):
                    raise
                self.record.partial.unlink(missing_ok=True)
            else:
                return

    def _get(self, delivery: Delivery) -> None:
        record, facts = self.record, delivery.facts(self.record.remote)
        if facts is None:
            raise RefusedError(f"{record.remote}: no such file", REJECTED, NOT_FOUND)
        if not self.is_worth_keeping:
            self.record = record = replace(record, **asdict(facts))
            self._records.keep(record)
        elif facts != Facts(record.size, record.crc32, record.modified_s):
            raise SpoiledError(f"{record.remote} has changed since; get it again")
        partial = record.partial
        with partial.open("ab") as file:
            done = file.tell()
            if done != record.size:
                done -= done % record.piece_bytes
            file.truncate(done)
            while done < record.size:
                size = min(record.piece_bytes, record.size - done)
                file.write(delivery.fetch(record.remote, done, size))
                sync_file(file)
                done += size
                self._progress(f"{record.remote}: {done} of {record.size} bytes")
        found = facts_of(partial)
        if found.size != record.size or record.crc32 not in (0, found.crc32):
            partial.unlink()
            raise SpoiledError(f"{record.remote}: the CRC differs; it may have changed")
        rename_file(partial, Path(record.local))

    def _put(self, delivery: Delivery) -> None:
        record, local = self.record, Path(self.record.local)
        here = facts_of(local) if local.is_file() else None
        if here is None or (here.size, here.crc32) != (record.size, record.crc32):
            raise SpoiledError(f"{local} has changed since; put it again")
        if record.size <= record.piece_bytes:
            delivery.store(local, _delivered(record.remote))
            self._check(delivery.facts(record.remote))
            return
        there = delivery.facts(record.uploaded)
        if there is None and record.moving:
            self._check(delivery.facts(record.remote))
            return
        done = there.size if there is not None else 0
        while done < record.size:
            size = min(record.piece_bytes, record.size - done)
            delivery.store(local, _delivered(record.piece), (done, size))
            delivery.ask("APPEND_FILE", path=record.piece, target=record.uploaded, offset=str(done))
            done += size
            self._progress(f"{record.remote}: {done} of {record.size} bytes")
        self._check(delivery.facts(record.uploaded))
        self.record = record = replace(record, moving=True)
        self._records.keep(record)
        _delete(delivery, record.remote)
        delivery.ask("MOVE_FILE", path=record.uploaded, target=record.remote)

    def _check(self, facts: Facts | None) -> None:
        """Compare the facts of the remote file with the record. Raises SpoiledError."""
        record = self.record
        good = facts is not None and facts.size == record.size
        if not good or (facts is not None and facts.crc32 not in (0, record.crc32)):
            raise SpoiledError(f"{record.remote}: not what was sent")


def carry_on(
    connect: Connect,
    work: Callable[[Delivery], int],
    until_s: float,
    wait_s: float,
    progress: Progress,
) -> int:
    """Return the result of some work over a link; repeat the work if the link is lost.

    Parameters
    ----------
    until_s : time of the monotonic clock [s] after which a lost link is not opened again
    wait_s : longest time [s] without a packet of the daemon; then the LinkError is raised
    """
    lost_s: float | None = None
    while True:
        is_heard = False
        try:
            with connect() as delivery:
                try:
                    return work(delivery)
                finally:
                    is_heard = delivery.is_heard
        except LinkError as error:
            now_s = time.monotonic()
            lost_s = now_s if lost_s is None or is_heard else lost_s
            if now_s + RETRY_S > min(until_s, lost_s + wait_s):
                raise
            progress(f"{error}; trying again")
            time.sleep(RETRY_S)


def _delivered(remote: str) -> str:
    """Return a remote name relative to the folder of file delivery."""
    return remote.removeprefix(f"{DELIVERED}/")


def _delete(delivery: Delivery, name: str) -> None:
    """Delete a remote file; ignore a missing one."""
    try:
        delivery.ask("DELETE_FILE", path=name)
    except RefusedError as error:
        if error.error != NOT_FOUND:
            raise
