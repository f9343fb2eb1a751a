"""What creeps although the model says that it does not: sensors that lie slowly.

A configuration that declares a gain, a zero or a mounting exact has no state for it. A slow change
leaves the residuals almost white, because the bodies follow it; it shows in the score of the change
itself. With whitened rows A and residuals b at the
estimate, whose covariance is P, a change of q quantities with the whitened columns G in the course
w (a weight for each block) has the score and its variance under a correct model

    s = sum w G^T b        v = sum w^2 diag(G^T G) - diag(C P C^T)        C = sum w G^T A

(Rao's test). The size s / v of the change moves the estimate by P C^T s / v. Courses are ramps that
begin at five instants, and a constant for what is declared exact. The columns are those of every
constant of joints and inertial unit, whether it is exact or a state.
Source: Rao, Linear Statistical Inference (1973), 6e; Nyblom, J. Am. Stat. Assoc. 84 (1989) 223.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from fsw.estimators.model.problem import Problem
from fsw.estimators.model.state_groups import group_of, in_words
from fsw.messages import FloatArray
from fsw.messages.false_alarms import sigmas

ONSETS = (0.0, 0.2, 0.4, 0.6, 0.8)  # of the ramps, as shares of the blocks
LEAST_BLOCKS = 8
GROUP = 512  # blocks whose products are in memory at once
LEAST_OWN = 1e-4  # least share of a column's variance that the states leave to it
NOTICED = sigmas("creep", sides=2)  # size above which a change widens sigma
REFUSED = sigmas("drift", sides=2)  # size above which a harmful change is a mismatch
HARM = 2.0  # sigmas by which a harmful change moves a body


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """Products of one block's whitened rows A (k, p), c (k,) with columns G (k, q)."""

    GA: FloatArray  # (q, p)
    Gc: FloatArray  # (q,)
    GG: FloatArray  # (q,) diagonal

    @staticmethod
    def of(A: FloatArray, c: FloatArray, G: FloatArray) -> Scores:
        """Return the products; b = c - A x at a state x."""
        return Scores(G.T @ A, G.T @ c, np.einsum("kq,kq->q", G, G))

    def weighted(self, weight: float) -> Scores:
        """Return the products of rows and columns times a weight."""
        if weight == 1.0:
            return self
        return Scores(weight**2 * self.GA, weight**2 * self.Gc, weight**2 * self.GG)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Creep:
    """The change that does most harm among those that the residuals show.

    Attributes
    ----------
    name : the state that seems to change
    onset : where the change begins, as a share of the blocks; None: it is off from the start
    sigmas : score of the change, in its own sigmas
    moved : (p,) by how much the change moves the estimate
    harm : by how much it moves a body's parameter, at most, in sigmas of the estimate
    """

    name: str
    onset: float | None
    sigmas: float
    moved: FloatArray
    harm: float

    @property
    def excess(self) -> FloatArray:
        """Return the covariance (p, p) that the change adds: `moved` squared minus its noise."""
        return np.asarray(_share(self.sigmas) * np.outer(self.moved, self.moved), np.float64)

    @property
    def is_refused(self) -> bool:
        """Return whether the change refuses the estimate.

        It does where chance does not explain it and it moves a body by more than HARM sigmas.
        """
        return self.sigmas > REFUSED and self.harm > HARM

    def words(self) -> str:
        """Return a text for an operator: what changes, by how much, and what to do."""
        course = "is not as declared" if self.onset is None else "changes within the run"
        group = group_of(self.name)
        cure = "" if group is None else f"; correct it, or state its doubt by {group.key}"
        return (
            f"{in_words(self.name)} {course} ({self.sigmas:.1f} of its own sigma), which moves a "
            f"body by {self.harm:.1f} sigma{cure}"
        )


def worst_change(changes: Iterable[Creep]) -> Creep | None:
    """Return the change that does most harm beyond noise; None if there are no changes."""
    return max(changes, key=lambda one: one.harm * _share(one.sigmas) ** 0.5, default=None)


def changes(
    problem: Problem,
    scores: Iterable[Scores],
    count: int,
    x: FloatArray,
    covariance: FloatArray,
    level: float,
) -> Iterator[Creep]:
    """Yield the changes of sensors that show in the residuals of an estimate.

    Parameters
    ----------
    scores, count : scores of the blocks, oldest first, and their number
    x : (p,) the estimate
    covariance : (p, p) of the estimate if the residuals are white
    level : ratio of the noise's variance to the declared one
    """
    if count < LEAST_BLOCKS or problem.watched is None:
        return
    ramps = [np.maximum(np.arange(count) / count - onset, 0.0) for onset in ONSETS]
    C, s, whole = _sums(scores, np.array([np.ones(count), *ramps]), x, level)
    v = whole - np.sum((C @ covariance) * C, axis=2)
    shows = v > LEAST_OWN * whole
    shows[0] &= [name not in problem.names for name in problem.watched.names]
    sizes = np.where(shows, np.abs(s) / np.sqrt(np.where(shows, v, 1.0)), 0.0)
    sigma = np.sqrt(np.diag(covariance)[problem.bodies])
    for course, k in np.argwhere(sizes > NOTICED).tolist():
        moved = covariance @ C[course, k] * (s[course, k] / v[course, k])
        yield Creep(
            name=problem.watched.names[k],
            onset=(None, *ONSETS)[course],
            sigmas=float(sizes[course, k]),
            moved=moved,
            harm=float(np.max(np.abs(moved[problem.bodies]) / sigma)),
        )


def _sums(
    scores: Iterable[Scores], weights: FloatArray, x: FloatArray, level: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return C (c, q, p), s (c, q) and sum w^2 diag(G^T G) (c, q) for c courses (c, blocks)."""
    totals: list[FloatArray] = []
    every, first = iter(scores), 0
    while group := list(islice(every, GROUP)):
        w = weights[:, first : first + len(group)]
        first += len(group)
        GA = np.array([one.GA for one in group]) / level
        GG = np.array([one.GG for one in group]) / level
        score = np.array([one.Gc for one in group]) / level - GA @ x
        sums = [np.tensordot(w, GA, 1), w @ score, w**2 @ GG]
        totals = [a + b for a, b in zip(totals, sums, strict=True)] if totals else sums
    C, s, whole = totals
    return C, s, whole


def _share(sigmas: float) -> float:
    """Return the share of a squared change that noise does not explain."""
    return max(0.0, 1.0 - (NOTICED / sigmas) ** 2)
