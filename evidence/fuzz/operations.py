"""Target for a whole daemon: an input is a sequence of hostile commands, tables, files and lines.

Loop and service are the real ones, in one process and in virtual time (`daemon_bench.py`). These
must hold: nothing raises; every telecommand is answered, and every accepted one is completed; every
line of the control socket has one answer; no event reports an unforeseen error; a file outside the
file area stays unchanged; a damaged or rejected packet is counted once and changes nothing.
"""

import atexit
import shutil
import tempfile
import zlib
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Protocol

from evidence.fuzz.choices import Choices
from evidence.fuzz.daemon_bench import LOOK_NS, OUTSIDE, OperationsBench
from evidence.fuzz.hostile import Grammar
from evidence.fuzz.oracle import Target, require
from fsw.telemetry.dictionary import DICTIONARY

MOST_STEPS = 24  # most steps of one input
WINDOW_TICKS = 110  # ticks for two windows and their lag
PIECE_BYTES = 900
TABLES = ("ROBOT", "NOISE", "RATES", "MONITORS")
KINDS, TURN = 200, 40  # 1 of 200 steps is an upload; each other kind in `_step` is 1 of 40
MEMORY = Path("/dev/shm")  # in memory, so that fsync is fast
NAMES = {(t.service, t.subtype, t.function_id): t.name for t in DICTIONARY.telecommands}


def operations_target() -> Target:
    """Return the target for a whole daemon in virtual time; the process's end closes its bench."""
    folder = fresh_folder()
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    bench = OperationsBench(folder)
    atexit.register(bench.close)
    return partial(play, bench)


def fresh_folder() -> Path:
    """Return a new folder for a bench, in memory if the system has /dev/shm."""
    return Path(
        tempfile.mkdtemp(prefix="fuzz-operations-", dir=MEMORY if MEMORY.is_dir() else None)
    )


class Attacked(Protocol):
    """A daemon under attack: in virtual time, or as processes."""

    grammar: Grammar
    counts: Counter[str]
    files: Path
    outside: Path

    def sequence(self) -> int:
        """Return the next sequence count for a telecommand."""

    def give(self, packet: bytes, name: str) -> None:
        """Send one telecommand and wait for its completion."""

    def command(self, name: str, **values: object) -> None:
        """Send a telecommand by name and wait for its completion."""

    def damaged(self, packet: bytes, choices: Choices) -> None:
        """Send a damaged telecommand and then a valid one; check both."""

    def repaired(self, packet: bytes, choices: Choices) -> None:
        """Send a changed telecommand with a correct check value."""

    def line(self, data: bytes) -> None:
        """Send one line to the control socket and wait for the answer."""

    def look(self, later_ns: int = LOOK_NS) -> None:
        """Let the service run until `later_ns` later [ns]."""

    def tick(self, count: int = 1) -> None:
        """Let the loop run for `count` ticks."""


def play(bench: Attacked, data: bytes) -> None:
    """Run one input as a sequence of hostile steps. Raises OracleError if a requirement fails."""
    choices = Choices(data)
    for _ in range(MOST_STEPS):
        if not choices.more:
            break
        _step(bench, choices)
    bench.look()
    require(bench.outside.read_bytes() == OUTSIDE, "a file outside was written", bench.outside)


def _step(bench: Attacked, choices: Choices) -> None:
    draw = choices.number(KINDS)
    kind = draw % TURN
    bench.counts["cases"] += 1
    if draw == 0:
        _upload(bench, choices)
    elif kind == 1:
        bench.line(bench.grammar.line(choices))
    elif kind == 2:
        _file(bench, choices)
    elif kind == 3:
        bench.look(choices.one((LOOK_NS, 1, 10**9, 6 * 10**9, 120 * 10**9)))
    elif kind == 4:
        bench.command("SET_MODE", mode=choices.one(("STANDBY", "IDENTIFY", "SAFE")))
    elif kind == TURN - 1:
        bench.damaged(bench.grammar.telecommand(choices, bench.sequence()), choices)
    elif kind == TURN - 2:
        bench.repaired(bench.grammar.telecommand(choices, bench.sequence()), choices)
    else:
        packet = bench.grammar.telecommand(choices, bench.sequence())
        bench.give(packet, name_of(packet))


def name_of(packet: bytes) -> str:
    """Return the name of the telecommand in a packet; empty if it is unknown."""
    service, subtype = packet[7], packet[8]
    function = int.from_bytes(packet[11:13], "big") if service == 8 else None
    return NAMES.get((service, subtype, function), "")


def _upload(bench: Attacked, choices: Choices) -> None:
    """Load, validate and activate a table; let the loop use an active robot or noise table."""
    number = choices.number(4)
    table, content = TABLES[number], bench.grammar.table(number, choices)
    crc32 = zlib.crc32(content)
    if choices.once_in(3):
        place = bench.files / "upload"
        place.write_bytes(content)
        bench.command("TBL_LOAD_FILE", table=table, crc32=crc32, path="files/upload")
    else:
        bench.command("TBL_LOAD", table=table, size_bytes=max(1, len(content)), crc32=crc32)
        for start in range(0, len(content), PIECE_BYTES):
            piece = content[start : start + PIECE_BYTES]
            bench.command("TBL_DATA", table=table, offset=start, data=piece)
    bench.command("TBL_VALIDATE", table=table)
    bench.command("SET_MODE", mode="STANDBY")
    before = bench.counts["TABLE_ACTIVATED"]
    bench.command("TBL_ACTIVATE", table=table, crc32=crc32)
    bench.counts["uploads"] += 1
    if bench.counts["TABLE_ACTIVATED"] > before and number < 2:
        bench.command("SET_MODE", mode="IDENTIFY")
        bench.tick(WINDOW_TICKS)
    if choices.once_in(2):
        bench.command("SET_MODE", mode="STANDBY")
        bench.command("TBL_ROLLBACK", table=table)


def _file(bench: Attacked, choices: Choices) -> None:
    """Put a file, a link or a folder into the file area, in place of an earlier file."""
    path = bench.files / choices.one(("a.txt", "loop", "deep", "table", "empty"))
    kind = choices.number(5)
    if path.is_symlink() or path.is_file():
        path.unlink()
    elif path.is_dir():
        return
    if kind == 0:
        path.write_bytes(choices.raw(200))
    elif kind == 1:
        path.symlink_to(bench.files / "loop")
    elif kind == 2:
        path.symlink_to(bench.outside)
    elif kind == 3:
        path.mkdir()
        (path / "er").write_bytes(b"x")
