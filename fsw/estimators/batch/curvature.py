"""Honest covariance where the posterior is not Gaussian: the likelihood's profile along weak axes.

A body's scale that the data hardly determine has a curved, lopsided likelihood, and the covariance
at its maximum says little about where the truth is. Along every weak axis v of the covariance
(normal n, n . v = 1) the cost is minimised at fixed n . (x - x0) = t. Where its rise D(t) differs
from t^2, or where the path bends off the axis, d d^T / D of the path's displacements d is added to
the covariance: the truth, which lies near the path, is then within sqrt(D) sigma. Source: profile
likelihood, Bates, Watts, Nonlinear Regression Analysis (1988), sec. 6.1.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fsw.estimators.model.state_groups import in_words
from fsw.messages import FloatArray

# normal n, value of n . x, first iterate -> point of least cost there, its cost (prior included)
Profile = Callable[[FloatArray, float, FloatArray], tuple[FloatArray, float]]

WEAK = 0.05  # of the prior's sigma: an axis that is known better needs no profile
MAX_AXES = 2
STEPS = (1.0, 3.0, 12.0)  # sigma of the linearisation
ENOUGH = 9.0  # rise of the cost at which the path of a side ends
OPEN = 4.0  # least rise of the cost that bounds a side
BENT = 0.5  # allowed difference of D / t^2 from 1, and squared offset from the axis over t^2
STIFF = 100.0  # weight of the constraint per sigma

NOTE = (
    "the error of {} is not that of a Gaussian: sigma is wider by the profile of its likelihood; "
    "method fused has narrower ones"
)
OPEN_NOTE = "the data do not limit {}: record another motion (fsw excite), or use method fused"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Widening:
    """Result of the profile; empty `note`: the linearisation holds and the sides are bounded."""

    covariance: FloatArray
    bounded: bool
    note: str


def widen(
    x: FloatArray,
    cost: float,
    covariance: FloatArray,
    prior_covariance: FloatArray,
    names: tuple[str, ...],
    bodies: int,
    profile: Profile,
    weak: float = WEAK,
) -> Widening:
    """Return the covariance (p, p), widened along weak axes where the cost is not a parabola.

    At most MAX_AXES axes are judged, of the first `bodies` states, marginal over the others, in
    units of `prior_covariance`.

    Parameters
    ----------
    x, cost : (p,) where the cost is least; least sum of squared whitened residuals, prior included
    weak : 1 sigma, in units of the prior's, above which an axis is judged
    """
    own = covariance[:bodies, :bodies]
    root = np.asarray(np.linalg.cholesky(prior_covariance[:bodies, :bodies]), dtype=np.float64)
    white: FloatArray = np.linalg.solve(root, np.linalg.solve(root, own).T)
    values, vectors = np.linalg.eigh(0.5 * (white + white.T))
    scale = np.sqrt(np.diag(covariance))
    factor = np.linalg.cholesky(covariance / np.outer(scale, scale) + 1e-12 * np.eye(len(scale)))
    wide = covariance.copy()
    bent, unbounded = [], []
    for index in np.argsort(-values)[:MAX_AXES]:
        if not values[index] > weak**2:
            break
        sigma = float(np.sqrt(values[index]))
        normal = np.zeros(len(x))
        normal[:bodies] = np.linalg.solve(root.T, vectors[:, index]) / sigma
        axis = covariance @ normal
        path, ended = [], True
        for sign in (1.0, -1.0):
            points, closed = _side(x, cost, axis, normal, profile, tuple(sign * t for t in STEPS))
            path += points
            ended = ended and closed
        off = [
            abs(rise / t**2 - 1.0) > BENT
            or float(np.sum(np.linalg.solve(factor, (d - t * axis) / scale) ** 2)) > BENT * t**2
            for t, d, rise in path
            if abs(t) <= 3.0
        ]
        share = np.abs(axis[:bodies]) / np.sqrt(np.diag(prior_covariance)[:bodies])
        label = names[int(np.argmax(share))]
        if any(off):
            bent.append(label)
            for t, d, rise in path:
                wide += np.outer(d, d) / max(rise, min(1.0, t**2) * 1e-2)
        if not ended:
            unbounded.append(label)
    notes = []
    if bent:
        notes.append(NOTE.format(_listed(bent)))
    if unbounded:
        notes.append(OPEN_NOTE.format(_listed(unbounded)))
    return Widening(covariance=wide, bounded=not unbounded, note="; ".join(notes))


def _side(
    x: FloatArray,
    cost: float,
    axis: FloatArray,
    normal: FloatArray,
    profile: Profile,
    steps: tuple[float, ...],
) -> tuple[list[tuple[float, FloatArray, float]], bool]:
    """Return step, displacement and rise along one side, and whether it is bounded.

    A step that reaches less than half of its aim has met the edge of the possible bodies.
    """
    points: list[tuple[float, FloatArray, float]] = []
    start, before = x, 0.0
    for t in steps:
        found, least = profile(normal, float(normal @ x) + t, start + (t - before) * axis)
        if not (np.isfinite(least) and np.all(np.isfinite(found))):
            return points, True
        d = found - x
        reached = float(normal @ d)
        if abs(reached) < 0.5 * abs(t):
            return points, True
        rise = max(least - cost, 0.0)
        points.append((reached, d, rise))
        if rise >= ENOUGH:
            return points, True
        start, before = found, t
    return points, points[-1][2] >= OPEN


def _listed(states: Sequence[str]) -> str:
    return ", ".join(map(in_words, states))
