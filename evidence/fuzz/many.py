"""Many hostile operations at full speed: random inputs without coverage, in resumable blocks.

`results.jsonl` has for every block without a failure the number of cases, the counts of events,
and the memory of the process at the end.
"""

import random
import shutil
from collections.abc import Iterator
from dataclasses import asdict, dataclass

from evidence.fuzz.daemon_bench import OperationsBench
from evidence.fuzz.operations import fresh_folder, play
from evidence.fuzz.oracle import OracleError
from evidence.store import Store
from hil.run.processes import resident_bytes

BLOCK_CASES = 10_000
INPUT_BYTES = 120


@dataclass(frozen=True, slots=True)
class Block:
    """The result of one block."""

    number: int
    cases: int
    happened: dict[str, int]  # counts of the bench by name, such as events
    resident_mb: float  # memory of this process at the end
    failure: str  # the failed input in hexadecimal digits and the error; empty without a failure


def blocks(cases: int, seed: int, store: Store) -> Iterator[Block]:
    """Run and yield the blocks that the store lacks, all in one bench; end after a failure.

    Parameters
    ----------
    seed : fixes all inputs; a resumed campaign has the same inputs
    """
    numbers = range(-(-cases // BLOCK_CASES))
    todo = [number for number in numbers if str(number) not in store.rows]
    folder = fresh_folder()
    bench = OperationsBench(folder)
    try:
        for number in todo:
            block = _play_block(bench, number, min(BLOCK_CASES, cases - number * BLOCK_CASES), seed)
            if not block.failure:
                store.add(str(number), asdict(block))
            yield block
            if block.failure:
                return
    finally:
        bench.close()
        shutil.rmtree(folder)


def _play_block(bench: OperationsBench, number: int, cases: int, seed: int) -> Block:
    rng = random.Random(f"{seed}/{number}")
    bench.counts.clear()
    failure = ""
    while bench.counts["cases"] < cases and not failure:
        data = rng.randbytes(INPUT_BYTES)
        try:
            play(bench, data)
        except OracleError as error:
            failure = f"{data.hex()}: {error}"
    happened = dict(bench.counts)
    return Block(number, happened["cases"], happened, resident_bytes() / 2**20, failure)


def summary(store: Store) -> dict[str, object]:
    """Return the number of cases, the counts by name, and the memory at the end of each block."""
    rows = list(store.rows.values())
    names = sorted({name for row in rows for name in row["happened"]})
    return {
        "cases": sum(row["cases"] for row in rows),
        "happened": {name: sum(row["happened"].get(name, 0) for row in rows) for name in names},
        "resident_mb": [round(row["resident_mb"], 1) for row in rows],
    }
