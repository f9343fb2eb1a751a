"""One case: a disk of a size, a way to spoil it, and a moment; what must hold, and what did."""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from evidence import pool
from evidence.disk import small
from evidence.disk.board import Board, configuration
from evidence.disk.ground_end import GroundEnd, Numbers
from file_delivery.entity import FileEntity
from file_delivery.library import DAEMON as BOARD
from file_delivery.library import GROUND, Pair
from fsw.config import Config
from fsw.exchange.recording import messages
from fsw.telemetry.dictionary.codes import Error, Mode, Store
from hil.run.bench import T0_NS

KINDS = ("full", "inodes", "read_only", "removed", "slow_sync")
MOMENTS = ("first_start", "next_start", "idle", "upload", "restart")
SIZES_KIB = (512, 768, 1024, 1536, 2048, 4096, 8192, 16384)
SYNC_NS = 3_000_000_000  # duration of a slow sync
LONGEST_S = 20.0  # until a telecommand has ended: six slow syncs and two seconds
HEALTHY_STEPS, BAD_STEPS, HEALED_STEPS = 20, 10, 80  # of 0.2 s
PINGS = 20  # more than the numbers that are stored ahead
UNSAID = 6  # newest messages that a crash or a removal may take without a count: one second
RUN_NS = 100_000_000_000  # time between the starts of two runs
UPLOAD = bytes(range(256)) * 200
OLD = "old"  # name of a file that the ground deletes


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A size, a kind and a moment."""

    size_kib: int
    kind: str
    moment: str

    def __str__(self) -> str:
        """Return the key of the case."""
        return f"{self.size_kib}-{self.kind}-{self.moment}"


@dataclass(slots=True, kw_only=True)
class Facts:
    """What happened in one run of the service."""

    first: int  # number of the first message
    last: int = 0  # behind the newest one
    counted_from: int = 0  # messages before it were removed by the case itself
    lost: int = 0  # as the recorder counts
    failed: list[str] = field(default_factory=list)
    longest_s: float = 0.0
    codes: dict[str, int] = field(default_factory=dict)
    uploaded: bool = False
    numbers: Numbers = field(default_factory=Numbers)


def cases() -> list[Case]:
    """Return the 200 cases."""
    return [
        Case(size_kib=size, kind=kind, moment=moment)
        for size in SIZES_KIB
        for kind in KINDS
        for moment in MOMENTS
    ]


def run(case: Case) -> Mapping[str, Mapping[str, Any]]:
    """Run a case; return its row by its key. Raises ScenarioError if no disk can be mounted."""
    with tempfile.TemporaryDirectory(prefix="hil-disk-") as name:
        folder = Path(name)
        with small.small_disk(folder, case.size_kib << 10) as disk:
            runs = _runs(case, configuration(folder, disk), disk)
            failed = [word for facts in runs for word in facts.failed]
            failed += _unkept(case, runs, disk)
    codes = {code: n for facts in runs for code, n in facts.codes.items()}
    values = {
        **asdict(case),
        "failed": sorted(set(failed)),
        "longest_s": max(facts.longest_s for facts in runs),
        "lost": sum(facts.lost for facts in runs),
        "given": runs[-1].last,
        "events": sorted(code for code in codes if code in SHOWN),
    }
    return {str(case): values}


SHOWN = (
    "DISK_FULL", "RECORDER_FAILED", "RECORDER_BACK", "TC_NOT_KEPT", "TM_NUMBERS_FAILED",
    "PACKET_STORE_FAILED", "CHECKPOINT_FAILED", "STATE_REMOVED", "CONTROL_FAILED", "BLOCKS_FAILED",
)  # fmt: skip


def _runs(case: Case, config: Config, disk: Path) -> list[Facts]:
    """Run the service before and after its restart, each time in a process of its own."""
    runs: list[Facts] = []
    numbers = Numbers()
    if case.moment == "first_start":
        _spoil(case, disk)
    else:
        runs.append(_forked(lambda: _first(case, config, disk, numbers)))
        numbers = runs[-1].numbers
        if case.moment == "next_start":
            _spoil(case, disk)
            if case.kind == "removed":
                runs[-1].counted_from = runs[-1].last
    first = runs[-1].last if runs else 0
    runs.append(_forked(lambda: _second(case, config, disk, numbers, first)))
    return runs


def _forked(work: Callable[[], Facts]) -> Facts:
    """Return the facts of work in a copy of this process."""
    try:
        return pool.forked("the service", work)
    except RuntimeError as error:
        return Facts(first=0, failed=[str(error)])


def _first(case: Case, config: Config, disk: Path, numbers: Numbers) -> Facts:
    """Run on a sound disk, and spoil it if that is the moment."""
    board, facts = _start(config, T0_NS, Facts(first=0, numbers=numbers))
    ground = GroundEnd(board.port, numbers, board.step)
    (disk / "state" / "files" / OLD).write_bytes(bytes(1000))
    for _ in range(HEALTHY_STEPS):
        ground.look()
    _expect(facts, "store switch", "completion_success" in _switch_off(ground))
    if case.moment == "next_start":
        board.close()
        return _ended(board, facts)
    uploading = _Upload(ground) if case.moment == "upload" else None
    if uploading is not None:
        uploading.work(3)
    if case.kind == "removed":
        facts.counted_from = board.given
    _spoil(case, disk)
    if case.kind == "slow_sync":
        board.slow_syncs(SYNC_NS)
    if uploading is not None:
        facts.uploaded = uploading.work(BAD_STEPS)
    for _ in range(BAD_STEPS):
        ground.look()
    if case.moment != "restart":
        _trial(case, board, ground, facts)
    return _ended(board, facts)


def _second(case: Case, config: Config, disk: Path, numbers: Numbers, first: int) -> Facts:
    """Start on the spoiled disk, try the link, heal the disk, and end in order."""
    board, facts = _start(config, T0_NS + RUN_NS, Facts(first=first, numbers=numbers))
    if case.kind == "slow_sync":
        board.slow_syncs(SYNC_NS)
    ground = GroundEnd(board.port, numbers, board.step)
    for _ in range(BAD_STEPS):
        ground.look()
    before = numbers.refused
    ground.command("PING")  # finds the number: a crash skips at most those stored ahead
    _trial(case, board, ground, facts)
    _expect(facts, "sealed telemetry", numbers.refused == before == 0)
    _replays(ground, facts)
    if case.kind in ("full", "inodes"):
        small.empty(disk)
        for _ in range(HEALED_STEPS):
            ground.look()
        wide = small.free_bytes(disk) > 2 * config.service.disk_reserve_bytes
        recording = board.service._switch.sink  # noqa: SLF001
        is_back = recording is not None and recording._writer is not None  # noqa: SLF001
        _expect(facts, "recording back", is_back or recording is None or not wide)
    ground.close()
    board.close()
    return _ended(board, facts)


def _start(config: Config, now_ns: int, facts: Facts) -> tuple[Board, Facts]:
    board = Board(config, now_ns, facts.first)
    facts.counted_from = facts.first
    return board, facts


def _ended(board: Board, facts: Facts) -> Facts:
    facts.last, facts.lost, facts.codes = board.given, board.lost, board.codes
    return facts


def _spoil(case: Case, disk: Path) -> None:
    spoilers = {
        "full": small.fill,
        "inodes": small.use_up_inodes,
        "read_only": small.read_only,
        "removed": small.remove,
    }
    if case.kind in spoilers:
        spoilers[case.kind](disk)


def _trial(case: Case, board: Board, ground: GroundEnd, facts: Facts) -> None:
    """Try the link and the commands that free space."""

    def timed(name: str, **values: object) -> Mapping[str, int]:
        began_ns = board.clock.now_ns()
        reports = ground.command(name, **values)
        facts.longest_s = max(facts.longest_s, (board.clock.now_ns() - began_ns) * 1e-9)
        return reports

    for number in range(PINGS):
        reports = timed("PING")
        _expect(facts, f"link: PING {number}: {dict(reports)}", "alive" in reports)
    there = board.service._directory / "files" / OLD  # noqa: SLF001
    missing = Error.FILE_NOT_FOUND if not there.exists() else Error.NONE
    freeing: tuple[tuple[str, dict[str, object], Error], ...] = (
        ("REPORT_FREE_SPACE", {}, Error.NONE),
        ("DELETE_FILE", {"path": f"files/{OLD}"}, missing),
        ("REC_STOP", {}, Error.NONE),
        ("SET_MODE", {"mode": int(Mode.SAFE)}, Error.NONE),
    )
    for name, values, error in freeing:
        reports = timed(name, **values)
        good = "acceptance_success" in reports or (
            error is not Error.NONE and reports.get("acceptance_failure") == error
        )
        _expect(facts, f"freeing {name}", good)
        if case.kind != "read_only" and name == "DELETE_FILE":
            _expect(facts, "deleted", not there.exists())
    reports = timed("REC_START")
    refused = reports.get("acceptance_failure") == Error.NOT_KEPT
    unkept = case.kind == "read_only" or case.moment == "first_start"  # no room was ever made
    _expect(facts, "other commands", "acceptance_success" in reports or (unkept and refused))
    _expect(facts, "event of its own", not refused or "TC_NOT_KEPT" in board.codes)
    _expect(facts, f"telecommand within {LONGEST_S:g} s", facts.longest_s <= LONGEST_S)


def _replays(ground: GroundEnd, facts: Facts) -> None:
    """Send every accepted frame again: none may be accepted."""
    frames = list(ground.numbers.accepted)
    for _ in range(3):
        ground.look()
    before = len([item for item in ground.found if item.packet.name == "acceptance_success"])
    for frame in frames:
        ground.again(frame)
    for _ in range(5):
        ground.look()
    after = len([item for item in ground.found if item.packet.name == "acceptance_success"])
    _expect(facts, "replay", after == before)


def _switch_off(ground: GroundEnd) -> Mapping[str, int]:
    return ground.command("DISABLE_STORE", store=int(Store.SCIENCE))


class _Upload:
    """A file on its way up."""

    def __init__(self, ground: GroundEnd) -> None:
        self._ground = ground
        self._folder = tempfile.TemporaryDirectory(prefix="hil-disk-up-")
        path = Path(self._folder.name) / "up"
        path.write_bytes(UPLOAD)
        ends = Pair(here=GROUND, there=BOARD)
        self._entity = FileEntity(Path(self._folder.name), ends=ends)
        self._entity.send(path, remove=False)
        self._now_ns = 0

    def work(self, steps: int) -> bool:
        """Carry units in both directions; return whether the daemon has received the file."""
        for _ in range(steps):
            self._now_ns += 200_000_000
            for unit in self._entity.poll(self._now_ns)[:20]:
                self._ground.unit(unit)
            self._ground.look()
            for unit in self._ground.units:
                self._entity.receive(unit, self._now_ns)
            self._ground.units.clear()
        return any(good for _, good, _ in self._entity.finished())


def _unkept(case: Case, runs: list[Facts], disk: Path) -> list[str]:
    """Return what was said to be kept and is not on the disk."""
    failed = []
    kept = {
        int.from_bytes(record.data[:8], "big")
        for path in (disk / "recordings").glob("*.mcap")
        for record in messages(path, ["/serial/numbered"])
    }
    for facts in runs:
        given = set(range(facts.counted_from, facts.last))
        if len(given - kept) > facts.lost + UNSAID:
            failed.append(f"kept: {len(given - kept)} missing, {facts.lost} counted")
    uploaded = any(facts.uploaded for facts in runs)
    file = disk / "state" / "files" / "up"
    if uploaded and case.kind != "removed" and file.read_bytes() != UPLOAD:
        failed.append("uploaded file")
    return failed


def _expect(facts: Facts, what: str, holds: bool) -> None:
    if not holds:
        facts.failed.append(what)
