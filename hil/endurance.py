"""Endurance of the online estimators: python -m hil.endurance RECORDING --config FLIGHT.yaml.

One recording's worth of blocks is pushed over and over with new indices and times. Measured:
memory between a tenth of the run and its end, whether the factor is finite, and the covariance
against a batch: the inverse of the summed normal matrix of every row folded in, accumulated apart
from the estimator. An update is one set of joint samples absorbed; a block holds window x rate.
"""

from __future__ import annotations

import argparse
import gc
import resource
import sys
import tracemalloc
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fsw.config import load
from fsw.estimators.online import OnlineEstimator, build_online
from fsw.messages import Block, FloatArray
from fsw.replay import replay
from fsw.sinks import NullSink

SAMPLES_PER_BLOCK = 200  # 0.4 s at 500 Hz
COVARIANCE_BOUND = 1e-6
GROWTH_BOUND_BYTES = 200_000  # a leak of one float per block of the shortest run stands out


@dataclass(frozen=True, slots=True, kw_only=True)
class Endurance:
    """What one long run showed."""

    blocks: int
    updates: int
    traced_bytes: tuple[int, int]  # early and at the end
    resident_kb: tuple[int, int]
    finite: bool
    covariance_difference: float  # largest, relative to the sigmas of the batch
    passed: bool


class Tally:
    """The batch: prior precision plus the normal matrix of the rows that stand in the estimator."""

    def __init__(self, online: OnlineEstimator) -> None:
        self._memory = online._store  # noqa: SLF001 - the instrument reads what it measures
        R = self._memory.prior.R
        self._retired: FloatArray = np.zeros_like(R)
        self._prior: FloatArray = R.T @ R
        self._oldest: Any = None

    def before_push(self) -> None:
        """Remember the block that may leave the store."""
        stored = self._memory._store  # noqa: SLF001
        self._oldest = stored[0] if stored else None

    def after_push(self) -> None:
        """Add the rows of the block that has left."""
        stored = self._memory._store  # noqa: SLF001
        if self._oldest is not None and stored[0] is not self._oldest:
            self._retired = self._retired + self._oldest.A.T @ self._oldest.A

    def covariance(self) -> FloatArray:
        """Return the batch covariance of everything folded in."""
        F = self._prior + self._retired
        for stored in self._memory._store:  # noqa: SLF001
            F = F + stored.A.T @ stored.A
        return np.asarray(np.linalg.solve(F, np.eye(len(F))), np.float64)


def again(blocks: list[Block], k: int, period_ns: int) -> Block:
    """Return the k-th block of an endless repetition."""
    lap, place = divmod(k, len(blocks))
    block = blocks[place]
    return replace(block, index=k, t_ns=block.t_ns + lap * len(blocks) * period_ns)


def endure(
    online: OnlineEstimator, blocks: list[Block], count: int, period_ns: int, *, progress: bool
) -> Endurance:
    """Push `count` blocks and judge; memory is first taken at a tenth of them."""
    tally = Tally(online)
    tracemalloc.start()
    early = (0, 0)
    for k in range(count):
        while online.work():
            pass
        tally.before_push()
        online.push(again(blocks, k, period_ns))
        tally.after_push()
        online.events()
        if k + 1 == max(count // 10, 1):
            early = _memory()
        if progress and (k + 1) % max(count // 100, 1) == 0:
            done = (k + 1) * SAMPLES_PER_BLOCK
            sys.stdout.write(f"\r{100 * (k + 1) // count:3d} %  {done:.1e} updates")
            sys.stdout.flush()
    while online.work():
        pass
    online.finish()
    late = _memory()
    tracemalloc.stop()
    memory = online._store  # noqa: SLF001
    finite = bool(np.all(np.isfinite(memory.information.R)))
    batch, got = tally.covariance(), memory.information.covariance()
    sigma = np.sqrt(np.diag(batch))
    difference = float(np.max(np.abs(got - batch) / np.outer(sigma, sigma)))
    grown = late[0] - early[0]
    return Endurance(
        blocks=count,
        updates=count * SAMPLES_PER_BLOCK,
        traced_bytes=(early[0], late[0]),
        resident_kb=(early[1], late[1]),
        finite=finite,
        covariance_difference=difference,
        passed=finite and difference < COVARIANCE_BOUND and grown < GROWTH_BOUND_BYTES,
    )


def _memory() -> tuple[int, int]:
    gc.collect()
    return tracemalloc.get_traced_memory()[0], resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


class _Blocks(NullSink):
    """Keeps the blocks of a replay."""

    def __init__(self) -> None:
        self.blocks: list[Block] = []

    def block(self, block: Block) -> None:
        """Keep one block."""
        self.blocks.append(block)


def main(arguments: list[str]) -> int:
    """Run from the command line; 0 if passed."""
    parser = argparse.ArgumentParser(prog="python -m hil.endurance")
    parser.add_argument("recording", type=Path)
    parser.add_argument("--config", type=Path, required=True)
    parser.add_argument("--updates", type=float, default=1e6)
    options = parser.parse_args(arguments)
    config = load(options.config)
    sink = _Blocks()
    replay(options.recording, config, sink=sink)
    online = build_online(config)
    if not isinstance(online, OnlineEstimator):
        sys.stderr.write("estimator.weighting bc keeps sums only; nothing to compare\n")
        return 2
    count = max(10, round(options.updates / SAMPLES_PER_BLOCK))
    period_ns = round(config.estimator.window_s * 1e9)
    result = endure(online, sink.blocks, count, period_ns, progress=True)
    sys.stdout.write(f"\n{result}\n")
    return 0 if result.passed else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
