"""Solution of a batch in which some blocks do not fit and noise differs from the declared."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, compress

import numpy as np
from scipy.special import chdtri

from fsw.estimators.batch.plain import BatchSolution
from fsw.estimators.batch.solver import Progress, Target, minimise
from fsw.estimators.block_view import fitting
from fsw.estimators.measurement.row_functions import Linearisation
from fsw.estimators.model.problem import Problem
from fsw.estimators.noise.creep import Scores, changes, worst_change
from fsw.estimators.noise.few_windows import FEW_WINDOWS
from fsw.estimators.noise.few_windows import in_words as few_in_words
from fsw.estimators.noise.likeness import in_words
from fsw.estimators.recursive.change import InnovationMonitor
from fsw.estimators.recursive.trust import Trust, is_scattered
from fsw.messages import Block, FloatArray

GATE_ROUNDS = 6
LEVEL_TOLERANCE = 0.05


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Settled:
    """The solution of the blocks that fit one another, for one prior."""

    solution: BatchSolution
    target: Target
    level: float
    used: Sequence[Block]
    residuals: Sequence[FloatArray]
    likely: FloatArray  # (p, p), wider where residuals are alike from block to block
    covariance: FloatArray  # (p, p), and where what is constant creeps
    misfit: bool  # many blocks do not fit the others, or residuals are far larger than noise
    against: str  # what noise does not explain; empty: nothing
    note: str  # why sigma is wider than that of the declared noise; empty: it is not

    @property
    def mismatch(self) -> bool:
        """Whether the residuals are not noise."""
        return bool(self.against)


def settle(
    problem: Problem,
    linear: Linearisation,
    blocks: Sequence[Block],
    gate_probability: float,
    progress: Progress | None,
    start: FloatArray | None,
    watch: Linearisation | None = None,
) -> Settled:
    """Solve, leave out blocks that do not fit, and repeat until the same blocks are left out.

    `watch`: rows of the same blocks with the columns of what might creep.
    """
    fits, scattered = [True] * len(blocks), ""
    noise = before = InnovationMonitor(0.0)
    for more in reversed(range(GATE_ROUNDS)):
        used, fitted = fitting(blocks, fits), fits
        target = Target(linear, fits, noise.variance)
        solution = minimise(problem, target, progress, start)
        every = chain.from_iterable(linear.parts(solution.mean, fits))
        whole = [(part.b.copy(), part.edge) for part in every]
        residuals = [b for b, _ in whole]
        left = list(compress(residuals, fits))
        if solution.status == "ABORTED":
            break
        few = not problem.is_free and len(left) < FEW_WINDOWS
        judged = compress(whole, fits) if few else whole
        at_nodes = [b[: len(b) - edge] for b, edge in judged]
        before, noise = noise, _noise(problem, at_nodes, solution)
        fits = fit(whole, noise.level, gate_probability)
        if is_scattered(fits.count(False), sum(fits)):
            scattered = f"{fits.count(False)} of {len(blocks)} windows do not fit the others"
            break
        moved = abs(noise.variance / before.variance - 1.0)
        if more == 0 or (fits == fitted and moved < LEVEL_TOLERANCE):
            break
        if solution.status != "NOT_CONVERGED":  # blocks that do not fit may have prevented it
            start = solution.mean
    trust, white, level = Trust(), solution.information.covariance(), noise.level
    if noise.variance != before.variance:  # of the last residuals, not of those before
        A, b = Target(linear, fitted, noise.variance)(solution.mean)
        white = problem.prior.at(solution.mean).update(A, b + A @ solution.mean).covariance()
    if solution.status != "ABORTED":
        rows = linear(solution.mean, fitted)
        trust.judge(problem, rows, used, level, white, noise.doubt)
        if watch is not None:
            seen = watch(solution.mean, fitted)
            scores = (Scores.of(s.A, s.b, s.watched) for s in seen if s.watched is not None)
            origin = np.zeros_like(solution.mean)
            found = changes(problem, scores, len(seen), origin, white, level)
            trust.watch(worst_change(found))
    covariance = trust.widened(white, len(left))
    alike = in_words(white, covariance, problem.names[: problem.bodies.stop]) * trust.alike
    no_body = solution.note * (solution.status not in ("NOT_CONVERGED", "ABORTED"))
    return Settled(
        solution=solution,
        target=target,
        level=level,
        used=used,
        residuals=left,
        misfit=solution.status != "ABORTED" and (bool(scattered) or trust.is_large(level)),
        likely=trust.likely(white, len(left)),
        covariance=covariance,
        note="; ".join(filter(None, (few_in_words(len(used), noise.doubt), alike))),
        against="; ".join(filter(None, (scattered, no_body, trust.in_words(level)))),
    )


def fit(found: Sequence[tuple[FloatArray, int]], level: float, probability: float) -> list[bool]:
    """Return which blocks fit, in order.

    A block that does not fit hands on a wrong motion, so the blocks after it do not fit at their
    edges. Of such a run this function leaves out the first block, and those whose nodes do not fit
    either. These then hand on no motion, and the next round judges the others.

    Parameters
    ----------
    found : per block its whitened residuals (r,), and how many of the last ones are of its edge
    level : ratio of the noise's variance to the declared one
    probability : probability of rejecting a block that fits
    """
    fits, follows = list[bool](), False
    for b, edge in found:
        nodes = b[: len(b) - edge]
        off, off_at_nodes = (
            float(own @ own) > level * float(chdtri(len(own), probability)) for own in (b, nodes)
        )
        fits.append(not (off_at_nodes or (off and not (edge and follows))))
        follows = off or off_at_nodes
    return fits


def _fitted(problem: Problem, solution: BatchSolution) -> float:
    """Return how many parameters the data have fitted: all minus the prior's share."""
    prior = problem.prior.at(solution.mean)
    held = prior.R @ solution.information.covariance_root()
    return float(len(prior.z) - np.sum(held**2))


def _noise(
    problem: Problem, residuals: Sequence[FloatArray], solution: BatchSolution
) -> InnovationMonitor:
    """Return the ratio of the noise's variance to the declared one, by the recursion's rule."""
    monitor, longest = InnovationMonitor(0.0), max(map(len, residuals))
    means = np.array([float(b @ b) / len(b) for b in residuals if len(b) == longest])
    fitted = _fitted(problem, solution)
    monitor.learn_level(means, longest, fitted, is_held=not problem.is_free)
    return monitor
