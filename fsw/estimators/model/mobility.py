"""Covariance of a weakly known base (sigma of tens of per cent), by way of its mobility.

A free base reacts to a force, and loads the arm, by its inverse inertia. The likelihood of torque
or rate is therefore nearly Gaussian in the ten mobility coordinates [1/m, centre of mass, inverse
central inertia], and not in pi: there, a sigma of a tenth of the mass already doubles the squared
normalised error. So the Gaussian is assumed in the base's mobility, and in the other states as they
are, and its covariance in pi is published. (The second moment about the estimate is larger by the
squared shift of the mean; it makes squared normalised errors 4 % too small.)

Source: the elimination of the base acceleration, paper eqs. (22)-(23); covariance of a mapped
Gaussian as in Julier, Uhlmann, Proc. IEEE 92 (2004), here from many fixed draws. Only the base's
ten states are drawn: given these, the others are linear, and their share is in closed form.

Where a switched force is a state too, the Gaussian in pi is left as it is: mass and moments
are then proportional to the scale of that force, and the likelihood is Gaussian in pi.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from fsw.estimators.model.inertia import PARAMETERS, from_parameters, report_jacobian
from fsw.estimators.model.problem import Problem
from fsw.messages import FloatArray

DRAWS = 2000  # covariances within 3 % where the mapping is nonlinear, exact where it is linear
STRAIGHT = 1.05  # largest ratio of variances at which the covariance in pi is kept
LOPSIDED = 1.25  # ratio of the longer side's sigma to sigma, above which it is published
IMPOSSIBLE = 0.01  # share of impossible draws above which the mapping is not used
TORQUE = ("mrnea", "rda", "fused")  # methods whose likelihood may be Gaussian in the mobility
NOTE = (
    "the base is known so weakly that its error is larger to one side; sigma covers both. A motion "
    "that moves the base more (fsw excite) makes it smaller"
)

_INDEX = ((0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2))  # xx xy xz yy yz zz
_SYMMETRIC = ((0, 1, 2), (1, 3, 4), (2, 4, 5))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mapped:
    """Covariance in pi of a Gaussian that is assumed in the mobility of the base.

    `stretch`: largest ratio of a mapped variance to the linearised one; 1 for a linear map.
    """

    covariance: FloatArray  # (p, p)
    stretch: float
    impossible: float  # share of draws that no body can have

    @property
    def bent(self) -> bool:
        """Return whether the linearisation in pi understates the covariance."""
        return self.stretch > STRAIGHT

    @property
    def holds(self) -> bool:
        """Return whether a body can have nearly all of the drawn mobilities."""
        return self.impossible <= IMPOSSIBLE


def is_bent(problem: Problem, method: str) -> bool:
    """Return whether a method's likelihood is Gaussian in the base's mobility instead of in pi."""
    torque = method in TORQUE and "base" in problem.unknown
    return torque and problem.switched.is_exact


def to_mobility(pi: FloatArray) -> FloatArray:
    """Return [1/m, centre of mass, inverse central inertia xx xy xz yy yz zz] (10,) of pi."""
    m, c, central = from_parameters(pi)
    return np.concatenate(([1.0 / m], c, _inverse(central)))


def from_mobility(mobility: FloatArray) -> FloatArray:
    """Return pi (10, ...) of mobilities (10, ...); inverse of `to_mobility`."""
    m = 1.0 / mobility[0]
    x, y, z = mobility[1:4]
    xx, xy, xz, yy, yz, zz = _inverse(mobility[4:])
    origin = [xx + m * (y * y + z * z), xy - m * x * y, yy + m * (x * x + z * z)]
    origin += [xz - m * x * z, yz - m * y * z, zz + m * (x * x + y * y)]
    return np.stack([m, m * x, m * y, m * z, *origin])


def mobility_jacobian(pi: FloatArray) -> FloatArray:
    """Return d(mobility)/d pi (10, 10) at pi (10,)."""
    report = report_jacobian(pi)
    inverse = to_mobility(pi)[4:][np.array(_SYMMETRIC)]
    J = report.copy()
    J[0] = -report[0] / pi[0] ** 2
    for k in range(10):
        J[4:, k] = -(inverse @ report[4:, k][np.array(_SYMMETRIC)] @ inverse)[_INDEX]
    return J


def by_mobility(x: FloatArray, covariance: FloatArray, base: slice) -> Mapped:
    """Return the covariance in pi of a Gaussian at x (p,) in the mobility of the states `base`.

    The draws have exactly the given covariance (p, p), so a linear map does not change it. The
    other states are `along` times the drawn ones, plus a rest that does not depend on them.
    """
    scale = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(scale, scale)
    root = np.linalg.cholesky(correlation[base, base])
    along = solve_triangular(root, correlation[base], lower=True)  # (10, p) per unit drawn
    unit = _draws(DRAWS)
    slope = mobility_jacobian(x[base]) @ (scale[base, None] * root)
    mobilities = to_mobility(x[base])[:, None] + slope @ unit
    kept = _bodies(mobilities)
    possible = max(1, int(np.sum(kept)))
    drawn, bent = unit[:, kept], from_mobility(mobilities[:, kept])
    bent -= np.sum(bent, axis=1, keepdims=True) / possible
    bent /= scale[base, None]
    mapped = correlation + along.T @ (drawn @ drawn.T / possible - np.eye(PARAMETERS)) @ along
    mapped[base] = bent @ drawn.T @ along / possible
    mapped[:, base] = mapped[base].T
    mapped[base, base] = bent @ bent.T / possible
    whole = np.linalg.cholesky(correlation)
    half = solve_triangular(whole, mapped, lower=True)
    ratio = solve_triangular(whole, half.T, lower=True)
    return Mapped(
        covariance=mapped * np.outer(scale, scale),
        stretch=float(np.linalg.eigvalsh(ratio)[-1]),
        impossible=1.0 - possible / DRAWS,
    )


def longer_sides(pi: FloatArray, covariance: FloatArray, prior_sigma: FloatArray) -> FloatArray:
    """Return sigma (10,) of mass, centre of mass and central inertia, on the longer side.

    A base that is known to a tenth may be heavier by more than it may be lighter: 1/m is Gaussian.
    Where the longer side has more than LOPSIDED times sigma, its own sigma is returned, at most the
    prior's sigma (10,). It is a third of the distance to the most likely body at three sigma in the
    mobility. Where no body is possible at three sigma, two or one sigma are used.
    """
    J, report = mobility_jacobian(pi), report_jacobian(pi)
    slope = np.linalg.solve(J.T, report.T).T  # d(report)/d(mobility)
    C = J @ covariance @ J.T
    sigma = np.sqrt(np.maximum(np.diag(report @ covariance @ report.T), 1e-300))
    ways, at, longer = C @ slope.T / sigma, to_mobility(pi), sigma.copy()
    here = np.concatenate([1.0 / at[:1], at[1:4], _inverse(at[4:])])
    for t in (1.0, 2.0, 3.0):
        sides = np.stack([at[:, None] + t * ways, at[:, None] - t * ways], axis=1)
        bodies = np.all(_bodies(sides), axis=0)
        with np.errstate(all="ignore"):  # no body has the mobility zero
            there = np.concatenate([1.0 / sides[:1], sides[1:4], _inverse(sides[4:])])
        far = np.abs(np.einsum("isi->si", there) - here).max(axis=0) / t
        longer[bodies] = far[bodies]
    longer = np.minimum(longer, np.maximum(sigma, prior_sigma))
    return np.where(longer > LOPSIDED * sigma, longer, sigma)


def _inverse(six: FloatArray) -> FloatArray:
    """Return the inverses (6, ...) of symmetric matrices (6, ...), both xx xy xz yy yz zz."""
    a, b, c, d, e, f = six
    xx, xy, xz = d * f - e * e, c * e - b * f, b * e - c * d
    adjugate = np.stack([xx, xy, xz, a * f - c * c, b * c - a * e, a * d - b * b])
    with np.errstate(divide="ignore", invalid="ignore"):  # a singular matrix belongs to no body
        inverse: FloatArray = adjugate / (a * xx + b * xy + c * xz)
    return inverse


def _bodies(mobility: FloatArray) -> NDArray[np.bool_]:
    """Return which mobilities (10, ...) a body can have.

    The mass and the second moments of mass about the centre of mass, tr(I) / 2 - I, must be
    positive definite (Wensing et al., RA-L 2018, sec. III), decided by leading minors.
    """
    xx, xy, xz, yy, yz, zz = _inverse(mobility[4:])
    a, d, f = 0.5 * (yy + zz - xx), 0.5 * (xx + zz - yy), 0.5 * (xx + yy - zz)
    minor = a * d - xy * xy
    whole = f * minor - a * yz * yz - d * xz * xz - 2.0 * xy * xz * yz
    possible: NDArray[np.bool_] = (mobility[0] > 0.0) & (a > 0.0) & (minor > 0.0) & (whole > 0.0)
    return possible


@lru_cache(maxsize=1)
def _draws(draws: int) -> FloatArray:
    """Return fixed draws (10, k) in opposite pairs; their mean is exactly 0, their covariance 1."""
    half = np.random.default_rng(0).standard_normal((PARAMETERS, draws // 2))
    both = np.concatenate([half, -half], axis=1)
    root = np.linalg.cholesky(both @ both.T / draws)
    white: FloatArray = solve_triangular(root, both, lower=True)
    white.setflags(write=False)
    return white
