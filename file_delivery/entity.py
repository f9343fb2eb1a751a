"""File delivery of class 2 (CCSDS 727.0-B), both ways, several files at a time.

cfdp-py provides the state machines. This module, `incoming` and `outgoing` add: limits on requests
of the other end, a transaction timeout, answers for ended transactions, reasons for refusals, names
confined to the file directory, a check of every file's checksum, final names only for complete
files, and cancelling, suspending and resuming of transfers.
"""

from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from spacepackets.cfdp import ConditionCode
from spacepackets.cfdp.pdu import FileDataPdu, MetadataPdu
from spacepackets.cfdp.pdu.helper import GenericPduPacket, PduHolder

from file_delivery.errors import DeliveryError
from file_delivery.incoming import PARTIAL, Incoming
from file_delivery.library import DAEMON, GROUND, Pair
from file_delivery.numbers import beginning
from file_delivery.outgoing import Outgoing
from file_delivery.room import check_room
from file_delivery.transfer import Key, Transfer, TransferOutcome
from file_delivery.units import (
    UnitError,
    is_for_sender,
    is_number_of,
    late_acknowledgement,
    needs_answer,
    packed,
    parse,
    transaction_of,
)

UNITS_PER_LOOK = 32  # most units per call of `poll`, which the service calls every 10 ms
SENDING_LIMIT, WAITING_LIMIT, RECEIVING_LIMIT = 4, 8, 8  # files
SILENT_NS = 5_000_000_000  # a transfer that is silent for longer may lose its place to another
REUSED_NS = 1_000_000_000  # metadata later than this after the end reuse the transaction's number
FROZEN_NS = 3_000_000_000  # a longer gap between two calls is a lost link, not a silent transfer
REMEMBERED = 64  # number of ended transactions that are remembered
MAX_FILE_BYTES = 1 << 30
COUNTED = (
    "files_sent",
    "files_received",
    "files_failed",
    "pdus_sent",
    "pdus_received",
    "pdus_rejected",
)
DAEMONS = Pair(here=DAEMON, there=GROUND)
Accepts = Callable[[str], bool]


def accept_every_name(name: str) -> bool:  # noqa: ARG001
    """Accept a file of any name."""
    return True


class FileEntity:
    """One end of file delivery; a call lasts no longer than reading or checking one file.

    Parameters
    ----------
    directory : received files are stored below it
    number : returns the number of a new transaction, never used before
    ends : entity identifiers; by default, this end is the daemon
    max_file_bytes : size of the largest file that is received [B]
    reserve_bytes : free space of the disk that received files leave alone [B]
    accepts : returns whether a file of this name is for this end; other files are ignored
    """

    def __init__(
        self,
        directory: Path,
        number: Callable[[], int] = beginning,
        *,
        max_file_bytes: int = MAX_FILE_BYTES,
        reserve_bytes: int = 0,
        ends: Pair = DAEMONS,
        accepts: Accepts = accept_every_name,
    ) -> None:
        self._directory, self._number, self._ends = directory, number, ends
        self._max_file_bytes, self._reserve_bytes = max_file_bytes, reserve_bytes
        self._accepts = accepts
        self._incoming: dict[Key, Incoming] = {}
        self._outgoing: dict[Key, Outgoing] = {}
        self._waiting: deque[Outgoing] = deque()
        self._over: OrderedDict[Key, tuple[TransferOutcome, int]] = OrderedDict()
        self._foreign: deque[Key] = deque(maxlen=REMEMBERED)
        self._late: deque[bytes] = deque(maxlen=UNITS_PER_LOOK)
        self._ended: list[tuple[int, bool, str]] = []
        self._counters: Counter[str] = Counter()
        self._looked_ns: int | None = None
        for left in directory.glob(f"{PARTIAL}*"):  # of a run that crashed
            with suppress(OSError):  # a disk that cannot be written takes no link away
                left.unlink()

    def send(
        self, path: Path, *, remove: bool, name: str = "", piece: tuple[int, int] | None = None
    ) -> int:
        """Queue a file for sending; return the transaction's number, at least 1.

        Parameters
        ----------
        path : path of the file, anywhere
        remove : whether to remove the local file once it has arrived
        name : file name at the other end; empty: the last part of `path`
        piece : offset and size [B] of the part to send; None: the whole file

        Raises
        ------
        DeliveryError FILE_NOT_FOUND or BUSY.
        """
        if not path.is_file():
            raise DeliveryError("FILE_NOT_FOUND", path.name)
        if len(self._waiting) >= WAITING_LIMIT:
            raise DeliveryError("BUSY", f"{WAITING_LIMIT} files wait to be sent")
        number = self._number()
        file = Outgoing(self._ends, number, path, name or path.name, piece, remove=remove)
        self._waiting.append(file)
        return number

    def receive(self, pdu: bytes, now_ns: int) -> None:
        """Process a received unit; count it as rejected if it is invalid or of no transfer."""
        self._thaw(now_ns)
        self._counters["pdus_received"] += 1
        try:
            unit = parse(pdu, self._max_file_bytes)
            if is_for_sender(unit):
                self._answer(unit, now_ns)
            else:
                self._take(unit, now_ns)
        except UnitError:
            self._counters["pdus_rejected"] += 1
        self._collect(now_ns)

    def poll(self, now_ns: int) -> list[bytes]:
        """Return the units to send now, at most `UNITS_PER_LOOK`."""
        self._thaw(now_ns)
        units = [self._late.popleft() for _ in range(len(self._late))]
        for file in list(self._incoming.values()):
            units += file.poll(UNITS_PER_LOOK - len(units), now_ns)
        self._start_waiting(now_ns)
        for key, sending in list(self._outgoing.items()):
            units += sending.pump(UNITS_PER_LOOK - len(units), now_ns)
            self._outgoing[key] = self._outgoing.pop(key)  # the other files are first next time
            if len(units) >= UNITS_PER_LOOK:
                break
        self._counters["pdus_sent"] += len(units)
        self._collect(now_ns)
        return units

    def transfers(self) -> list[Transfer]:
        """Return the transfers that have not ended."""
        return [file.transfer for file in self._all() if file.outcome is None]

    @property
    def is_idle(self) -> bool:
        """Whether no transfer is in progress and no unit is left to send."""
        return not (self._incoming or self._outgoing or self._waiting or self._late)

    def cancel(self, key: Key) -> None:
        """Cancel a transfer and report this to the other end. Raises DeliveryError."""
        file = self._find(key)
        if isinstance(file, Incoming):
            file.refuse(ConditionCode.CANCEL_REQUEST_RECEIVED, "cancelled")
        else:
            file.cancel("cancelled")
            if file in self._waiting:
                self._waiting.remove(file)
                self._outgoing[key] = file

    def suspend(self, key: Key) -> None:
        """Suspend a transfer and stop its timers. Raises DeliveryError."""
        self._find(key).suspended = True

    def resume(self, key: Key, now_ns: int) -> None:
        """Continue a suspended transfer. Raises DeliveryError."""
        file = self._find(key)
        file.suspended, file.last_ns = False, now_ns

    def finished(self) -> list[tuple[int, bool, str]]:
        """Return number (0: received), success and text of transfers ended since the last call."""
        ended, self._ended = self._ended, []
        return ended

    def counters(self) -> Mapping[str, int]:
        """Return the counters of files and units (PDUs) by name, see `COUNTED`."""
        return {name: self._counters[name] for name in COUNTED}

    def _all(self) -> Iterable[Incoming | Outgoing]:
        return [*self._incoming.values(), *self._outgoing.values(), *self._waiting]

    def _find(self, key: Key) -> Incoming | Outgoing:
        for file in self._all():
            if file.key == key and file.outcome is None:
                return file
        raise DeliveryError("FILE_NOT_FOUND", f"no transfer {key[1]} of entity {key[0]}")

    def _answer(self, unit: GenericPduPacket, now_ns: int) -> None:
        """Pass a unit to its outgoing file. Raises UnitError if no transfer has that number."""
        for file in self._outgoing.values():
            if file.outcome is None and is_number_of(unit, file.key):
                file.answer(unit, now_ns)
                return
        for key, (outcome, _) in reversed(self._over.items()):
            if is_number_of(unit, key):
                self._answer_late(unit, outcome)
                return
        raise UnitError("no such transaction")

    def _take(self, unit: GenericPduPacket, now_ns: int) -> None:
        key = transaction_of(unit)
        if isinstance(unit, MetadataPdu):
            self._forget_if_reused(key, now_ns)
        file = self._incoming.get(key)
        if file is None:
            if key in self._foreign:
                return
            if key in self._over:
                self._answer_late(unit, self._over[key][0])
                return
            file = Incoming(self._directory, self._ends, unit, now_ns)
            self._admit(file, now_ns)
        if isinstance(unit, MetadataPdu) and not self._accepts(unit.dest_file_name or ""):
            self._foreign.append(key)
            del self._incoming[key]
            return
        if isinstance(unit, MetadataPdu) and not file.closed:
            self._check_size(file, unit.file_size or 0)
        elif isinstance(unit, FileDataPdu) and not file.closed:
            self._check_room(file, len(unit.file_data))
        if not file.closed:
            file.take(unit, now_ns)

    def _forget_if_reused(self, key: Key, now_ns: int) -> None:
        """Forget an ended transaction if metadata reuse its number: its sender has restarted."""
        if key in self._over and now_ns - self._over[key][1] > REUSED_NS:
            del self._over[key]
            file = self._incoming.pop(key, None)
            if file is not None:
                file.abandon("")

    def _check_size(self, file: Incoming, size: int) -> None:
        if size > self._max_file_bytes:
            text = f"{size} bytes; at most {self._max_file_bytes}"
            file.refuse(ConditionCode.FILE_SIZE_ERROR, text)
            return
        self._check_room(file, size, new_file=True)

    def _check_room(self, file: Incoming, size: int, *, new_file: bool = False) -> None:
        """Refuse a file if `size` bytes more of it do not leave the reserve of the disk."""
        try:
            check_room(self._directory, self._reserve_bytes, size, new_file=new_file)
        except OSError as error:
            text = f"{size} bytes: {error.strerror or error}"
            file.refuse(ConditionCode.FILESTORE_REJECTION, text)

    def _admit(self, file: Incoming, now_ns: int) -> None:
        """Give a new file a place, if needed that of an ended or silent file, or refuse it."""
        under_way = [other for other in self._incoming.values() if not other.closed]
        if len(under_way) >= RECEIVING_LIMIT:
            rest = [other for other in under_way if other.outcome is not None] or under_way
            oldest = min(rest, key=lambda other: other.last_ns)
            if oldest.outcome is not None or now_ns - oldest.last_ns > SILENT_NS:
                oldest.abandon("silent, and another file needs its place")
                self._collect(now_ns)
            else:
                text = f"{RECEIVING_LIMIT} files are on their way"
                file.refuse(ConditionCode.CANCEL_REQUEST_RECEIVED, text)
        self._incoming[file.key] = file

    def _start_waiting(self, now_ns: int) -> None:
        if not self._waiting:
            return
        busy = [file for file in self._outgoing.values() if file.outcome is None]
        if len(busy) >= SENDING_LIMIT:
            oldest = min(busy, key=lambda file: file.last_ns)
            if now_ns - oldest.last_ns <= SILENT_NS:
                return
            oldest.give_up("no answer, and another file needs its place")
        file = self._waiting.popleft()
        file.begin(now_ns)
        self._outgoing[file.key] = file

    def _thaw(self, now_ns: int) -> None:
        """Leave a long gap between two calls out of all timeouts: the link was lost."""
        gap_ns = now_ns - self._looked_ns if self._looked_ns is not None else 0
        self._looked_ns = now_ns
        if gap_ns > FROZEN_NS:
            for file in self._all():
                file.last_ns = min(now_ns, file.last_ns + gap_ns)

    def _answer_late(self, unit: GenericPduPacket, outcome: TransferOutcome) -> None:
        reply = packed(PduHolder(late_acknowledgement(unit, outcome.condition)))
        if reply is not None:
            self._late.append(reply)
        if outcome.answer is not None and needs_answer(unit):
            self._late.append(outcome.answer)

    def _collect(self, now_ns: int) -> None:
        for key, file in list(self._incoming.items()):
            if file.outcome is not None and key not in self._over:
                self._note(key, file.outcome, 0, "files_received", now_ns)
            if file.closed and file.outcome is not None:
                self._late.extend(file.poll(UNITS_PER_LOOK, now_ns))
                del self._incoming[key]
        for key, sending in list(self._outgoing.items()):
            if sending.outcome is not None and key not in self._over:
                self._note(key, sending.outcome, key[1], "files_sent", now_ns)
            if sending.closed:
                del self._outgoing[key]

    def _note(
        self, key: Key, outcome: TransferOutcome, number: int, counter: str, now_ns: int
    ) -> None:
        self._over[key] = (outcome, now_ns)
        while len(self._over) > REMEMBERED:
            self._over.popitem(last=False)
        self._counters[counter if outcome.is_good else "files_failed"] += 1
        self._ended.append((number, outcome.is_good, outcome.text))
