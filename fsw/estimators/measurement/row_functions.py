"""The methods as row functions, which the recursive and the batch solution share."""

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from itertools import chain, compress, groupby, pairwise

import numpy as np

from fsw.errors import EstimatorError
from fsw.estimators.measurement.block_stack import BlockStack, stacks_of
from fsw.estimators.measurement.energy import stacked_energy_rows
from fsw.estimators.measurement.fused import stacked_fused_rows
from fsw.estimators.measurement.impulse import Impulse
from fsw.estimators.measurement.mrnea import Rows, stacked_mrnea_rows
from fsw.estimators.measurement.prediction import CHANNELS, Rate
from fsw.estimators.model.problem import Problem, Watched
from fsw.messages import Block, FloatArray

MOST_BLOCKS = 512  # whose rows are in memory at once: 3 min at 0.4 s, some 100 MB


class RowsFunction(ABC):
    """Whitened rows of blocks at a state, given the momentum gained before them."""

    @abstractmethod
    def stacked(self, s: BlockStack, x: FloatArray, before: Impulse | None = None) -> list[Rows]:
        """Return A and b of every block with A delta = b, and the momentum gained after it."""

    def __call__(self, block: Block, x: FloatArray, before: Impulse | None = None, /) -> Rows:
        """Return the rows of one block."""
        return self.stacked(BlockStack((block,)), x, before)[0]


class Linearisation:
    """The rows of many blocks as a function of the state.

    Rows need a hundred times the memory of their block. Those of at most MOST_BLOCKS blocks are
    kept for the last state; those of more blocks are computed part by part in every pass.
    """

    def __init__(self, rows: RowsFunction, blocks: Sequence[Block]) -> None:
        self._rows, self._blocks = rows, blocks
        self._is_long = len(blocks) > MOST_BLOCKS
        self._key: tuple[bytes, bytes | None] | None = None
        self._found: list[Rows] = []

    def __len__(self) -> int:
        """Return the number of blocks."""
        return len(self._blocks)

    def __call__(self, x: FloatArray, fits: Sequence[bool] | None = None) -> Collection[Rows]:
        """Return the rows of the blocks for which `fits` holds (None: all), as `parts` does."""
        if self._is_long:
            return _Passes(self, x, fits)
        found = self._kept(x, fits)
        return found if fits is None else list(compress(found, fits))

    def parts(self, x: FloatArray, fits: Sequence[bool] | None = None) -> Iterator[list[Rows]]:
        """Yield the rows of at most MOST_BLOCKS blocks, momentum carried from block to block.

        Every block has rows, but one that does not fit hands on no motion to the next.
        """
        if not self._is_long:
            yield self._kept(x, fits)
            return
        before: Impulse | None = None
        for first in range(0, len(self._blocks), MOST_BLOCKS):
            own = slice(first, first + MOST_BLOCKS)
            found, before = linearised(
                self._rows, self._blocks[own], x, before, None if fits is None else fits[own]
            )
            yield found

    def _kept(self, x: FloatArray, fits: Sequence[bool] | None) -> list[Rows]:
        key = x.tobytes(), None if fits is None or all(fits) else bytes(fits)
        if self._key != key:
            self._key = None
            self._found, _ = linearised(self._rows, self._blocks, x, None, fits)
            self._key = key
        return self._found


class _Passes(Collection[Rows]):
    """The rows of a long linearisation at a state; each iteration computes them again."""

    def __init__(self, linear: Linearisation, x: FloatArray, fits: Sequence[bool] | None) -> None:
        self._linear, self._x = linear, x.copy()
        self._fits = [True] * len(linear) if fits is None else list(fits)

    def __len__(self) -> int:
        return sum(self._fits)

    def __iter__(self) -> Iterator[Rows]:
        every = chain.from_iterable(self._linear.parts(self._x, self._fits))
        return compress(every, self._fits)

    def __contains__(self, rows: object) -> bool:
        return any(own is rows for own in self)


def usable_rows(
    rows: RowsFunction,
    blocks: Sequence[Block],
    at: FloatArray,
    before: Impulse | None,
    fits: Sequence[bool] | None = None,
) -> list[Rows]:
    """Return `linearised` rows of consecutive blocks.

    The list is empty if the base has no inertia at `at`, or rows of a block are not finite.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        try:
            made, _ = linearised(rows, blocks, at, before, fits)
        except ValueError:  # LinAlgError, or scipy's check of its input
            return []
    finite = all(np.all(np.isfinite(own.A)) and np.all(np.isfinite(own.b)) for own in made)
    return made if finite else []


def linearised(
    rows: RowsFunction,
    blocks: Sequence[Block],
    x: FloatArray,
    before: Impulse | None,
    fits: Sequence[bool] | None = None,
) -> tuple[list[Rows], Impulse | None]:
    """Return the rows of consecutive blocks, and what they hand on; `fits`: see `parts`."""
    found = list[Rows]()
    ends = [k + 1 for k, fit in enumerate(fits or ()) if not fit]
    for first, last in pairwise([0, *ends, len(blocks)]):
        for s in stacks_of(blocks[first:last]):
            found += rows.stacked(s, x, before)
            before = found[-1].after
        if last in ends and before is not None:
            before = before.without_motion()
    return found, before


def stack(rows: RowsFunction, blocks: Sequence[Block], x: FloatArray) -> Collection[Rows]:
    """Return the whitened rows of every block at a state, momentum carried from block to block."""
    return Linearisation(rows, blocks)(x)


class _Fused(RowsFunction):
    def __init__(self, problem: Problem, channels: tuple[str, ...], rate: Rate | None) -> None:
        self._problem, self._channels, self._rate = problem, channels, rate

    def stacked(self, s: BlockStack, x: FloatArray, before: Impulse | None = None) -> list[Rows]:
        """Return the rows; if the method sets no rate, the gyro's is used where there is one.

        An estimated momentum is constant in inertial axes, and impulses of switched forces are
        summed in these axes. A block without attitude therefore shows nothing of the momentum; its
        torque and specific force are predicted from the measured rate.
        """
        problem, channels = self._problem, self._channels
        by_gyro = s.has_gyro and problem.is_free
        rate: Rate = self._rate or ("measured" if by_gyro else "momentum")
        adds_up = problem.has("momentum") or len(problem.switched) > 0
        adds_up |= problem.watches_outside
        if adds_up and not s.has_attitude:
            rate = "measured"
            channels = tuple(c for c in channels if c != "gyro" and by_gyro)
        return stacked_fused_rows(s, x, problem, channels, rate, before)


class _Watched(RowsFunction):
    """Rows with additional columns, those of what might creep."""

    def __init__(self, problem: Problem, watched: Watched) -> None:
        names = watched.problem.names
        self._own = np.array([names.index(name) for name in problem.names], np.intp)
        self._size, self._columns = len(names), watched.columns
        self._rows = _Fused(watched.problem, CHANNELS, "momentum")

    def stacked(self, s: BlockStack, x: FloatArray, before: Impulse | None = None) -> list[Rows]:
        """Return the rows; what is declared exact is as declared."""
        at = np.zeros(self._size)
        at[self._own] = x
        found = self._rows.stacked(s, at, before)
        return [
            replace(one, A=one.A[:, self._own].copy("C"), watched=one.A @ self._columns)
            for one in found
        ]


class _Mrnea(RowsFunction):
    """MRNEA; RDA for blocks in which the measurement of a base row, or a torque, is missing."""

    def __init__(self, problem: Problem, weighting: str) -> None:
        self._problem, self._weighting = problem, weighting
        self._otherwise = _Fused(problem, ("torque",), None)

    def stacked(self, s: BlockStack, x: FloatArray, before: Impulse | None = None) -> list[Rows]:
        """Return the rows; RDA's where a force changes, because rates are then no polynomials."""
        found: list[Rows] = []
        for fires, group in groupby(s.blocks, self._fires):
            own = tuple(group)
            part = s if len(own) == len(s.blocks) else BlockStack(own)
            if part.is_complete and self._problem.is_free and not fires:
                found += stacked_mrnea_rows(part, x, self._problem, self._weighting)
            else:
                found += self._otherwise.stacked(part, x, before)
                before = found[-1].after
        return found

    def _fires(self, block: Block) -> bool:
        return self._problem.switched.changes(block)


class _Energy(RowsFunction):
    """The balance of work; RDA for blocks in which a torque, and with it its work, is missing."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._otherwise = _Fused(problem, ("torque",), None)

    def stacked(self, s: BlockStack, x: FloatArray, before: Impulse | None = None) -> list[Rows]:
        """Return the rows; those of the balance do not depend on `before`."""
        if s.has_joint.all():
            return stacked_energy_rows(s, x, self._problem)
        return self._otherwise.stacked(s, x, before)


def watched_rows(problem: Problem) -> RowsFunction | None:
    """Return the rows of `fused` with the columns of what might creep; None: nothing is watched."""
    return None if problem.watched is None else _Watched(problem, problem.watched)


def row_function(method: str, weighting: str, problem: Problem) -> RowsFunction:
    """Return the rows of a method: mrnea, rda, cm, ce or fused.

    MRNEA's base rows need accelerometer and gyro. In a block without one of them the torques are
    used as RDA's, with the rate that the momentum gives if the gyro is missing. In a block in which
    a torque is missing, MRNEA and CE use the other torques as RDA's.

    Raises
    ------
    EstimatorError for an unknown method, and for ce with thrusters.
    """
    functions: dict[str, RowsFunction] = {
        "mrnea": _Mrnea(problem, weighting),
        "rda": _Fused(problem, ("torque",), None),
        "cm": _Fused(problem, ("gyro",), "momentum"),
        "ce": _Energy(problem),
        "fused": _Fused(problem, CHANNELS, "momentum"),
    }
    if method not in functions:
        raise EstimatorError(f"method {method!r} is not one of {', '.join(functions)}")
    if method == "ce" and len(problem.switched):
        raise EstimatorError("method 'ce' cannot include firings: they move the whole robot")
    return functions[method]
