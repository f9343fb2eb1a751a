"""Endurance of the online estimators: python -m evidence.speed.endurance [--updates 1e6].

One virtual flight's blocks are pushed over and over with new indices and times. Measured for every
estimator: memory from the first 1e5 updates on (bytes reachable from the estimator, the
interpreter's allocated blocks, resident pages), whether the factor is finite, and the covariance
against a batch: the inverse of the summed normal matrix of every row folded in, accumulated apart
from the estimator. An update is one set of joint samples absorbed; a block holds window x rate.
Results are kept in the folder of `--out`; what stands there already is not run again.
"""

import argparse
import gc
import json
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, Protocol

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: one core

import numpy as np
from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from fsw.estimators.recursive.online import OnlineEstimator, build_online
from fsw.messages import Block, FloatArray
from hil.options import seed
from hil.run.flown import Flown, fly, with_estimator
from hil.run.processes import resident_bytes

ESTIMATORS = {
    "mrnea ols": ("mrnea", "ols"),
    "mrnea wls": ("mrnea", "wls"),
    "mrnea eiv": ("mrnea", "eiv"),
    "rda": ("rda", "eiv"),
    "cm": ("cm", "eiv"),
    "fused": ("fused", "eiv"),
}
FIRST_LOOK_UPDATES = 100_000
COVARIANCE_BOUND = 1e-6
OWN_GROWTH_BYTES = 4096  # of the estimator, for longer integers; a float per block is 100 kB
LEAKED_OBJECTS = 0.1  # bound per block; an object kept per block is 1
SPARE_OBJECTS = 1000  # allowed for progress bars, caches and free lists
RESIDENT_GROWTH_KB = 4096  # allowed for the allocator; an array kept per block is 100 MB
SHOW_BLOCKS = 20  # blocks between two updates of the progress bar


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """The memory after a number of updates."""

    updates: int
    own_bytes: int  # size of everything that is reachable from the estimator
    objects: int  # memory blocks allocated by the interpreter
    resident_kb: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Endurance:
    """The figures of one estimator's long run."""

    estimator: str
    blocks: int
    updates: int
    looks: tuple[Look, ...]  # in the order of updates
    finite: bool  # whether the final covariance is finite
    covariance_difference: float  # largest to the batch, relative to the sigmas of the batch

    @property
    def flat(self) -> bool:
        """Whether the memory grew within its bounds from the first to the last look."""
        first, last = self.looks[0], self.looks[-1]
        pushed = self.blocks * (1.0 - first.updates / last.updates)
        return (
            last.own_bytes - first.own_bytes < OWN_GROWTH_BYTES
            and last.objects - first.objects < SPARE_OBJECTS + LEAKED_OBJECTS * pushed
            and last.resident_kb - first.resident_kb < RESIDENT_GROWTH_KB
        )

    @property
    def passed(self) -> bool:
        """Whether memory is flat, and the covariance is finite and equal to that of the batch."""
        return self.flat and self.finite and self.covariance_difference < COVARIANCE_BOUND

    def line(self) -> str:
        """Return the figures as one line of text."""
        first, last = self.looks[0], self.looks[-1]
        return (
            f"{'ok' if self.passed else 'MISSED':7}{self.estimator:10} {self.updates:.0e} updates: "
            f"from {first.updates:.0e} on estimator {last.own_bytes - first.own_bytes:+d} bytes of "
            f"{last.own_bytes}, {last.objects - first.objects:+d} objects, "
            f"{last.resident_kb - first.resident_kb:+d} kB resident; factor "
            f"{'finite' if self.finite else 'NOT FINITE'}; covariance off by "
            f"{self.covariance_difference:.1e} sigma^2"
        )


class Tally(Protocol):
    """Sums the normal matrix of all rows that an estimator gets, independently of it."""

    def before_push(self, block: Block) -> None:
        """Prepare for a block that is about to be pushed."""
        ...

    def after_push(self) -> None:
        """Account for the block that was pushed."""
        ...

    def covariances(self) -> tuple[FloatArray, FloatArray]:
        """Return the covariance (p, p) of the batch and that of the estimator."""
        ...


class StoredTally:
    """Prior precision plus normal matrices of the rows that a relinearising estimator has used."""

    def __init__(self, online: OnlineEstimator) -> None:
        self._memory = online.recursion.memory
        R = self._memory.prior.R
        self._F: FloatArray = R.T @ R
        self._oldest: Any = None

    def before_push(self, _block: Block) -> None:
        """Keep the oldest stored block, which may leave the store."""
        stored = self._memory._store  # noqa: SLF001 - a measurement of the private store
        self._oldest = stored[0] if stored else None

    def after_push(self) -> None:
        """Add the rows of the oldest block if it has left the store."""
        stored = self._memory._store  # noqa: SLF001
        if self._oldest is not None and stored[0] is not self._oldest:
            self._F = self._F + self._oldest.A.T @ self._oldest.A

    def covariances(self) -> tuple[FloatArray, FloatArray]:
        """Return both covariances, from all rows so far."""
        F = self._F
        for stored in self._memory._store:  # noqa: SLF001
            F = F + stored.A.T @ stored.A
        return inverse(F), self._memory.information.covariance()


class LinearTally:
    """Prior precision plus normal matrices of rows that depend only on the block."""

    def __init__(self, online: OnlineEstimator) -> None:
        self._memory, self._rows = online.recursion.memory, online.rows
        self._at = online.problem.prior_mean
        R = self._memory.prior.R
        self._F: FloatArray = R.T @ R

    def before_push(self, block: Block) -> None:
        """Add the rows of a block."""
        A = self._rows(block, self._at, None).A
        self._F = self._F + A.T @ A

    def after_push(self) -> None:
        """Do nothing."""

    def covariances(self) -> tuple[FloatArray, FloatArray]:
        """Return both covariances from all rows, not yet scaled by the residuals' variance."""
        return inverse(self._F), self._memory.information.covariance()


def inverse(F: FloatArray) -> FloatArray:
    """Return the inverse of a normal matrix, scaled to a unit diagonal before the inversion."""
    scale = np.sqrt(np.diag(F))
    scaled = np.linalg.solve(F / np.outer(scale, scale), np.eye(len(F)))
    P: FloatArray = scaled / np.outer(scale, scale)
    return P


def again(blocks: Sequence[Block], k: int, period_ns: int) -> Block:
    """Return block k of an endless repetition, with new index and time; `period_ns` per block."""
    lap, place = divmod(k, len(blocks))
    block = blocks[place]
    return replace(block, index=k, t_ns=block.t_ns + lap * len(blocks) * period_ns)


def endure(
    name: str, flown: Flown, updates: float, show: Callable[[int], None] = lambda _done: None
) -> Endurance:
    """Update an estimator with one flight's blocks again and again; return memory and covariance.

    Memory is first measured after a tenth of the updates, at most `FIRST_LOOK_UPDATES`, but not
    before two laps of the flight (or half of a short run), because the store of blocks grows until
    then. Later it is measured after each factor of ten and at the end. `show` gets the updates.
    """
    config = with_estimator(flown.config, *ESTIMATORS[name])
    window_s = config.estimator.window_s
    per_block = round(window_s * config.buses[0].rate_hz)
    count = max(10, round(updates / per_block))
    online = build_online(config, flown.model)
    tally: Tally = LinearTally(online) if online.linear else StoredTally(online)
    due = min(FIRST_LOOK_UPDATES // per_block, count // 10)
    # the last pass is over, and all blocks that it shared its point with have left the store
    due = max(due, min(3 * len(flown.blocks), count // 2))
    looks: list[Look] = []
    for k in range(count):
        online.work()
        block = again(flown.blocks, k, round(window_s * 1e9))
        tally.before_push(block)
        online.push(block)
        tally.after_push()
        online.events()
        if k + 1 in (due, count):
            while online.recursion.memory.in_pass:  # which has memory of its own
                online.work()
            looks.append(look((k + 1) * per_block, online))
            due *= 10
        if k % SHOW_BLOCKS == 0:
            show((k + 1) * per_block)
    online.work()
    batch, got = tally.covariances()
    sigma = np.sqrt(np.diag(batch))
    return Endurance(
        estimator=name,
        blocks=count,
        updates=count * per_block,
        looks=tuple(looks),
        finite=bool(np.all(np.isfinite(got))),
        covariance_difference=float(np.max(np.abs(got - batch) / np.outer(sigma, sigma))),
    )


def look(updates: int, online: object) -> Look:
    """Return the present memory after a garbage collection."""
    gc.collect()
    return Look(
        updates=updates,
        own_bytes=reachable_bytes(online),
        objects=sys.getallocatedblocks(),
        resident_kb=resident_bytes() // 1024,
    )


def reachable_bytes(root: object) -> int:
    """Return the size of an object and all objects that it refers to, without code and classes."""
    seen, waiting, size = {id(root)}, [root], 0
    while waiting:
        thing = waiting.pop()
        size += sys.getsizeof(thing)
        parts = [*gc.get_referents(thing)]
        if isinstance(thing, np.ndarray) and thing.base is not None:
            parts.append(thing.base)
        if isinstance(thing, FunctionType):
            parts = [cell.cell_contents for cell in thing.__closure__ or ()]
        for part in parts:
            if id(part) not in seen and not isinstance(part, type | ModuleType):
                seen.add(id(part))
                waiting.append(part)
    return size


def stored(folder: Path | None, updates: float, scenario: str) -> tuple[dict[str, Endurance], Path]:
    """Return the results of a scenario and length in a folder, by estimator, and their file."""
    if folder is None:
        return {}, Path(os.devnull)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{scenario}-{updates:.0e}.jsonl"
    found = {}
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            values = json.loads(line)
            values["looks"] = tuple(Look(**one) for one in values["looks"])
            found[values["estimator"]] = Endurance(**values)
    return found, path


def _advance(progress: Progress, task: TaskID, done: int) -> None:
    progress.update(task, completed=done)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run every requested estimator; return 0 if all passed, else 1."""
    parser = argparse.ArgumentParser(prog="python -m evidence.speed.endurance", description=__doc__)
    parser.add_argument(
        "estimators",
        nargs="*",
        metavar="NAME",
        help=f"of: {', '.join(repr(n) for n in ESTIMATORS)}; without one, all",
    )
    parser.add_argument("--updates", type=float, default=1e6, metavar="N", help="1e6")
    parser.add_argument("--scenario", default="target_leo", help="flown for its blocks")
    parser.add_argument("--seed", type=seed, default=0, metavar="K", help="of the flight, 0")
    parser.add_argument("--out", type=Path, metavar="DIR", help="keep results, resume from them")
    options = parser.parse_args(arguments)
    wanted = options.estimators or list(ESTIMATORS)
    unknown = sorted(set(wanted) - set(ESTIMATORS))
    if unknown:
        parser.error(f"{unknown} are none of {list(ESTIMATORS)}")
    found, path = stored(options.out, options.updates, options.scenario)
    missing = [name for name in wanted if name not in found]
    if missing:
        flown = fly(options.scenario, options.seed)
        columns = (
            TextColumn("{task.description:10}"),
            BarColumn(),
            TextColumn("{task.percentage:.0f} %"),
        )
        times = (TimeElapsedColumn(), TimeRemainingColumn())
        with Progress(
            *columns, *times, console=Console(stderr=True), refresh_per_second=2
        ) as progress:
            for name in missing:
                task = progress.add_task(name, total=options.updates)
                show = partial(_advance, progress, task)
                result = endure(name, flown, options.updates, show)
                found[name] = result
                with path.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(result)) + "\n")
    sys.stdout.write("\n".join(found[name].line() for name in wanted) + "\n")
    return 0 if all(found[name].passed for name in wanted) else 1


if __name__ == "__main__":
    sys.exit(main())
