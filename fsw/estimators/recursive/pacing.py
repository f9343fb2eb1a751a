"""When the recursion re-linearises, and how far the point moves, so that it settles and rests."""

from typing import Any

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dtrtri

from fsw.estimators.measurement.continuity import NOISE_POWER
from fsw.estimators.recursive.snapshot import Values, kept, put
from fsw.messages import FloatArray

SETTLED = 0.02  # whitened rms step of a pass below which the estimate has settled
SETTLED_IN_DOUBT = 0.05  # the same of the bodies alone, where arm and calibration are states
WORTH = 0.01  # expected step of a pass below which the pass is not worth its time
FAR = 0.5  # whitened rms distance from the last point at which the expected step is not trusted
LEAST_PULL = 1 / 16
BACK = 0.5  # cosine between a move and the last one reversed, above which the move leads back
MISFIT = 2.0  # mean squared residual at a pass's point above which a pass must not raise it
RETURN = 0.75  # share of a step that is taken back where it fits worse
_OF_STEPS = ("_last_move", "_last_step", "_last_since", "_pull", "_from")
_OF_FIT = ("_misfit", "_before", "_good", "_returns")
_STATE = ("settled", *_OF_STEPS, *_OF_FIT)


class Pacing:
    """Record of the last pass; distances are whitened, rms over the states.

    Attributes
    ----------
    settled : whether the last pass moved the estimate by less than the bound
    """

    def __init__(self, *, settled: bool, bound: float = SETTLED) -> None:
        """`bound`: the step below which the estimate has settled."""
        self.settled, self._bound = settled, bound
        self._last_move = self._last_step = np.inf
        self._last_since = 1
        self._before: FloatArray | None = None  # the point before the last pass's
        self._misfit = np.inf  # there
        self._good: FloatArray | None = None  # this point, if the last pass's fits worse
        self._returns = False  # whether the last pass's point took a step back
        self._pull = 1.0  # share of the way to the estimate that the next pass's point moves
        self._from: FloatArray | float = 0.0  # point before the last pass's, used with R

    def is_worth_a_pass(self, drift: float, since: int) -> bool:
        """Return whether re-linearising now is expected to move the estimate.

        Parameters
        ----------
        drift : distance of the estimate from the last pass's point
        since : blocks folded in since the start
        """
        return drift > FAR or self.is_expected_to_move(drift, since)

    def is_expected_to_move(self, drift: float, since: int) -> bool:
        """Return whether a pass is expected to move the estimate enough to be worth its time.

        The last pass's step is scaled, linearly or quadratically, by how far the point would move.
        """
        if not self.settled or not np.isfinite(self._last_move):
            return True
        ratio = drift / max(self._last_move, 1e-9) * since / self._last_since
        return bool(self._last_step * ratio * max(1.0, ratio) > WORTH)

    def point(
        self, wanted: FloatArray, previous: FloatArray, R: FloatArray | None = None
    ) -> FloatArray:
        """Return the next pass's point: not all the way to `wanted` after passes that failed.

        With the root R of an information, a move that leads back is halved: passes oscillate there.
        Most of a step to a point that fits worse is taken back, because it was longer than its
        linearisation holds; Gauss-Newton steps may diverge otherwise. No step from a point that is
        far off (NOISE_POWER) is taken back.
        """
        good, self._good, self._returns = self._good, None, self._good is not None
        if good is not None:
            return previous + RETURN * (good - previous)
        pull = self._pull
        if R is not None:
            now, last = R @ (wanted - previous), R @ (previous - self._from)
            if now @ last < -BACK * np.linalg.norm(now) * np.linalg.norm(last):
                pull = min(pull, 0.5)
            self._from = previous
        return wanted if pull >= 1 else previous + pull * (wanted - previous)

    def begin(self, move: float, since: int, previous: FloatArray, misfit: float) -> None:
        """Record how far the point of a pass lies from the one before, and the blocks so far.

        Parameters
        ----------
        previous, misfit : the point before, and the mean squared whitened residual there
        """
        self._last_move, self._last_since = move, since
        self._before, self._misfit = previous, misfit

    def end(self, step: float, failed: int, misfit: float) -> None:
        """Record by how much a pass moved the estimate, in how many blocks it failed, and its fit.

        `misfit` is the mean squared whitened residual at the pass's point.
        """
        self._pull = max(self._pull / 2, LEAST_PULL) if failed else min(1.0, self._pull * 2)
        self._last_step = step
        self.settled = step < self._bound and failed == 0
        is_worse = misfit > max(self._misfit, MISFIT) and self._misfit < NOISE_POWER
        is_worse = is_worse and not self.settled
        self._good = self._before if is_worse and not self._returns else None

    def found_idle(self, step: float) -> None:
        """Record by how much a pass not worth its time would have moved the estimate."""
        self._last_step = step

    def snapshot(self) -> dict[str, Any]:
        """Return the state as plain values."""
        return kept(self, _STATE)

    def restore(self, values: Values) -> None:
        """Continue from a snapshot."""
        put(self, _STATE, values)


def rms(values: FloatArray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(values @ values / len(values)))


def distance(R: FloatArray, step: FloatArray, bodies: slice | None = None) -> float:
    """Return the rms of a step whitened by an information's root R; of `bodies` alone if given."""
    if bodies is None:
        return rms(R @ step)
    root = dtrtri(R)[0][bodies]
    L = np.linalg.cholesky(root @ root.T)
    return rms(solve_triangular(L, step[bodies], lower=True))
