"""Memory of the recursion: a prior, retired information, and the newest blocks.

The information of the data is kept apart from the prior's, so that either can be replaced. Passes
re-linearise the rows of stored blocks, some blocks at a time. A block that leaves the full store
stays in the retired information with its newest linearisation, so memory is bounded and nothing is
counted twice. Forgetting multiplies the data's information by one factor per step of time: in the
retired information, the stored rows and a pass under way alike. The prior is never forgotten.
"""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsw.errors import EstimatorError
from fsw.estimators.measurement.impulse import Impulse
from fsw.estimators.measurement.mrnea import Rows
from fsw.estimators.noise.creep import Scores
from fsw.estimators.recursive.snapshot import (
    Values,
    from_impulse,
    from_information,
    kept,
    put,
    to_impulse,
    to_information,
)
from fsw.estimators.square_root import SquareRootInformation
from fsw.messages import Block, FloatArray

# rows of consecutive blocks at a state, given what is handed on to them, and which of them count;
# nothing: the rows of one of them are not usable there
SafeRows = Callable[[Sequence[Block], FloatArray, Impulse | None, Sequence[bool]], Sequence[Rows]]
_COUNTS = ("passes", "failed", "rows", "_visited", "_total", "_failures", "at")
_INFORMATION = ("prior", "data", "_retired", "_pass")
_IMPULSES = ("gained", "_gained_retired", "_gained_in_pass")


@dataclass(slots=True, eq=False)
class _Stored:
    """A block with its newest whitened rows, as weight (A x = c), and the momentum after it.

    `at` and `before` are the state and momentum that the rows were made from. After a restart the
    rows are made again when they are needed.
    """

    block: Block
    A: FloatArray
    c: FloatArray
    at: FloatArray
    before: Impulse | None
    after: Impulse | None
    weight: float = 1.0
    made: bool = True
    root: FloatArray | None = None
    use: NDArray[np.bool_] | None = None
    edge: int = 0
    scores: Scores | None = None
    fresh: Scores | None = None  # of a pass under way, which the estimate does not have yet

    def take(self, rows: Rows, at: FloatArray, *, in_pass: bool) -> None:
        """Replace the rows by those made at a state."""
        self.A, self.c, self.made = rows.A, rows.b + rows.A @ at, True
        self.root, self.use, self.edge = rows.root, rows.use, rows.edge
        if rows.watched is not None:
            found = Scores.of(rows.A, self.c, rows.watched)
            self.scores, self.fresh = (self.scores, found) if in_pass else (found, None)

    @property
    def handed_on(self) -> Impulse | None:
        """What the next block begins with: no motion of a block that does not count."""
        return self.after if self.weight or self.after is None else self.after.without_motion()

    def into(self, information: SquareRootInformation) -> SquareRootInformation:
        return information.update(self.weight * self.A, self.weight * self.c)


class Memory:
    """Prior, data information and stored blocks of one estimation.

    Attributes
    ----------
    prior : information without data
    data : information of the data alone, singular until there are enough data
    information : information of prior and data
    at : (p,) point of the running or last pass, or of the last one found not worth its time
    passes : passes completed
    rows : rows folded in since the restart
    failed : blocks that could not be re-linearised in the last pass, with their old rows kept
    gained : momentum gained from external moments up to the newest block
    """

    def __init__(self, prior: SquareRootInformation, capacity: int) -> None:
        self._capacity = capacity
        self.passes = 0
        self.restart(prior)

    def restart(
        self, prior: SquareRootInformation, data: SquareRootInformation | None = None
    ) -> None:
        """Discard all blocks; start from `prior`, and from `data`, which forgetting applies to."""
        p = len(prior.z)
        start = data or SquareRootInformation(np.zeros((p, p)), np.zeros(p))
        self.prior = prior
        self.data = self._retired = start
        self._store: deque[_Stored] = deque()
        self._unmade: deque[_Stored] = deque()  # restored blocks without rows so far
        self._rows_of: SafeRows | None = None
        self._pass: SquareRootInformation | None = None
        self._visited = self._total = self._failures = 0
        self.gained: Impulse | None = None
        self._gained_retired: Impulse | None = None
        self._gained_in_pass: Impulse | None = None
        self.failed = self.rows = 0
        self.at = prior.mean()
        self._combine()

    def __len__(self) -> int:
        return len(self._store)

    @property
    def in_pass(self) -> bool:
        """Return whether a pass is under way."""
        return self._pass is not None

    def replace_prior(self, prior: SquareRootInformation) -> None:
        """Replace the prior and keep the data."""
        self.prior = prior
        self._combine()

    def age(self, factor: float) -> None:
        """Multiply the square root of all the data's information by a factor."""
        if factor == 1.0:
            return
        self._retired = _scaled(self._retired, factor)
        self.data = _scaled(self.data, factor)
        if self._pass is not None:
            self._pass = _scaled(self._pass, factor)
        for stored in self._store:
            stored.weight *= factor
        self._combine()

    def add(
        self, block: Block, rows: Rows, at: FloatArray, *, keep: bool, weight: float = 1.0
    ) -> None:
        """Fold in the whitened rows of a block at a state; with `keep`, store the block for passes.

        A block of weight 0 adds no information: it only propagates momentum and modes.
        """
        stored = _Stored(block, rows.A, rows.b, at, self.gained, rows.after, weight)
        stored.take(rows, at, in_pass=False)
        self.gained = stored.handed_on
        self.rows += len(rows.b) if weight else 0
        self.data = stored.into(self.data)
        self._combine()
        if not keep:
            return
        if self._pass is not None and self.gained is None:
            self._pass = stored.into(self._pass)
        elif self._pass is not None:
            self._total += 1
        self._store.append(stored)
        if len(self._store) > self._capacity:
            self._retire()

    def begin(self, at: FloatArray) -> None:
        """Begin a pass that re-linearises every stored block at one point."""
        self._pass, self.at = self._retired, at
        self._gained_in_pass = self._gained_retired
        self._visited, self._total, self._failures = 0, len(self._store), 0

    @property
    def left(self) -> int:
        """Return how many blocks the pass has not re-linearised so far."""
        return self._total - self._visited

    def advance(self, rows: SafeRows, most: int = 1) -> bool:
        """Re-linearise the next blocks of the pass; return whether this ended the pass.

        The pass includes blocks that were added since it began. It re-linearises them too if they
        depend on the blocks before them, because momentum and modes followed from its old point.
        Doing all at once takes a quarter of the time of one after the other; the rows are the same.
        """
        if self._pass is None:
            return False
        due = list(islice(self._store, self._visited, min(self._visited + most, self._total)))
        fits = [stored.weight > 0.0 for stored in due]
        blocks = [stored.block for stored in due]
        found = rows(blocks, self.at, self._gained_in_pass, fits) if due else ()
        for k, stored in enumerate(due):
            new = found[k : k + 1] or rows((stored.block,), self.at, self._gained_in_pass, ())
            self._pass = self._revisited(stored, new).into(self._pass)
        if self.left:
            return False
        self.data, self._pass = self._pass, None
        for stored in self._store:
            stored.scores, stored.fresh = stored.fresh or stored.scores, None
        self.gained = self._gained_in_pass
        self.failed = self._failures
        self.passes += 1
        self._combine()
        return True

    def _revisited(self, stored: _Stored, found: Sequence[Rows]) -> _Stored:
        """Return a block with its rows of the pass, or with its old ones if there are none."""
        if found:
            (new,) = found
            stored.take(new, self.at, in_pass=True)
            # a copy, so that memory does not grow once passes have ended
            stored.at, stored.before = self.at.copy(), self._gained_in_pass
            stored.after = new.after
        else:
            self._failures += 1
        self._gained_in_pass = stored.handed_on
        self._visited += 1
        return self._with_rows(stored)

    def pull(self, rows: SafeRows, at: FloatArray, samples: int) -> FloatArray | None:
        """Return by how much a pass at a point would change the normal equations' right side (p,).

        Some stored blocks, evenly spread, serve for the estimate; None if one of them cannot be
        re-linearised. No pass is begun.
        """
        total = np.zeros(len(at))
        for index in np.linspace(0, len(self._store) - 1, samples).astype(int).tolist():
            stored = self._with_rows(self._store[index])
            found = rows((stored.block,), at, stored.before, ())
            if not found:
                return None
            (new,) = found
            old = stored.A.T @ (stored.c - stored.A @ at)
            total += stored.weight**2 * (new.A.T @ new.b - old)
        return total * (len(self._store) / samples)

    @property
    def blocks(self) -> tuple[Block, ...]:
        """Return the stored blocks, oldest first."""
        return tuple(stored.block for stored in self._store)

    def snapshot(self) -> dict[str, Any]:
        """Return everything but the blocks themselves, which are referred to by their index."""
        store = self._store
        values = kept(self, _COUNTS)
        values |= {name.lstrip("_"): from_information(getattr(self, name)) for name in _INFORMATION}
        values |= {name.lstrip("_"): from_impulse(getattr(self, name)) for name in _IMPULSES}
        return values | {
            "blocks": [stored.block.index for stored in store],
            "points": np.array([stored.at for stored in store]),
            "weights": np.array([stored.weight for stored in store]),
            "before": [from_impulse(stored.before) for stored in store],
            "after": [from_impulse(stored.after) for stored in store],
        }

    def restore(self, values: Values, blocks: Mapping[int, Block], rows: SafeRows) -> None:
        """Continue from a snapshot; `rows` makes the stored rows again, one by one when needed.

        Raises
        ------
        EstimatorError if a block is missing; this memory is unchanged then.
        """
        missing = [index for index in values["blocks"] if index not in blocks]
        if missing:
            raise EstimatorError(f"block {missing[0]} of the state is missing")
        p = len(values["at"])
        store: deque[_Stored] = deque()
        columns = [values[name] for name in ("blocks", "points", "weights", "before", "after")]
        for index, at, weight, before, after in zip(*columns, strict=True):
            store.append(
                _Stored(
                    blocks[index],
                    np.zeros((0, p)),
                    np.zeros(0),
                    at,
                    to_impulse(before),
                    to_impulse(after),
                    float(weight),
                    made=False,
                )
            )
        put(self, _COUNTS, values)
        for name in _INFORMATION:
            held = values[name.lstrip("_")]
            setattr(self, name, None if held is None else to_information(held))
        for name in _IMPULSES:
            setattr(self, name, to_impulse(values[name.lstrip("_")]))
        self._store = store
        self._unmade = deque(reversed(store))
        self._rows_of = rows
        self._combine()

    def make_one(self) -> None:
        """Make the rows of the newest restored block that has none."""
        if self._unmade:
            self._with_rows(self._unmade.popleft())

    def _with_rows(self, stored: _Stored) -> _Stored:
        if not stored.made and self._rows_of is not None:
            for made in self._rows_of((stored.block,), stored.at, stored.before, ()):
                stored.take(made, stored.at, in_pass=self.in_pass)
            stored.made = True
        return stored

    def residual_levels(self, x: FloatArray, newest: int) -> tuple[FloatArray, int]:
        """Return mean squared whitened residuals of the newest blocks, and the last one's rows."""
        recent = [self._with_rows(s) for s in list(self._store)[-newest:] if s.weight]
        levels = [float(np.mean((s.c - s.A @ x) ** 2)) for s in recent if len(s.c)]
        return np.array(levels), len(recent[-1].c) if recent else 0

    def misfit(self, x: FloatArray) -> float:
        """Return the mean squared whitened residual of the stored blocks at a state x (p,)."""
        residuals = [s.c - s.A @ x for s in self._store if s.weight and s.made]
        every = np.concatenate([np.zeros(0), *residuals])
        return float(np.mean(every**2)) if every.size else 0.0

    def rows_at(self, x: FloatArray) -> tuple[list[Rows], list[Block]]:
        """Return rows at a state x (p,), A by the root of its weight, and the stored blocks."""
        every = [self._with_rows(stored) for stored in self._store if stored.weight]
        used = [stored for stored in every if len(stored.c)]
        rows = [Rows(s.weight * s.A, s.c - s.A @ x, None, s.root, s.use, edge=s.edge) for s in used]
        return rows, [s.block for s in used]

    def scores(self) -> list[Scores]:
        """Return the products of the stored blocks with what might creep, oldest first.

        Empty while the rows of the estimate are missing: after a restart within a pass.
        """
        every = [(s.weight, self._with_rows(s).scores) for s in self._store if s.weight]
        known = [own.weighted(weight) for weight, own in every if own is not None]
        return known if len(known) == len(every) else []

    def tempered(self, level: float) -> SquareRootInformation:
        """Return the information if the data's noise variance is `level` times the declared one."""
        return self.information if level == 1.0 else _joined(self.prior, self.data, level**-0.5)

    def fitted(self) -> float:
        """Return how many parameters the data have fitted: all minus the prior's share."""
        held = self.prior.R @ self.information.covariance_root()
        return float(len(self.prior.z) - np.sum(held**2))

    def _combine(self) -> None:
        self.information = _joined(self.prior, self.data, 1.0)

    def _retire(self) -> None:
        oldest = self._with_rows(self._store.popleft())
        self._retired = oldest.into(self._retired)
        self._gained_retired = oldest.handed_on
        if self._pass is not None:
            if self._visited > 0:
                self._visited -= 1
            else:
                self._pass = oldest.into(self._pass)
                self._gained_in_pass = oldest.handed_on
            self._total -= 1


def _scaled(information: SquareRootInformation, factor: float) -> SquareRootInformation:
    return SquareRootInformation(factor * information.R, factor * information.z)


def _joined(
    prior: SquareRootInformation, data: SquareRootInformation, factor: float
) -> SquareRootInformation:
    return prior.update(factor * data.R, factor * data.z)


def data_within(
    prior: SquareRootInformation, mean: FloatArray, covariance: FloatArray
) -> SquareRootInformation:
    """Return the information that data must have added to `prior` to give this estimate.

    It is zero in directions in which rounding makes the estimate less certain than the prior.
    `mean` is (p,), `covariance` is (p, p).
    """
    p = len(mean)
    precision = np.linalg.solve(covariance, np.eye(p))
    F = precision - prior.R.T @ prior.R
    g = precision @ mean - prior.R.T @ prior.z
    values, vectors = np.linalg.eigh(0.5 * (F + F.T))
    keep = values > 1e-12 * values[-1]
    root = np.sqrt(values[keep])
    empty = SquareRootInformation(np.zeros((p, p)), np.zeros(p))
    return empty.update(root[:, None] * vectors[:, keep].T, (vectors[:, keep].T @ g) / root)
