"""Covariance of a base that is known to some tens of per cent, by way of its mobility.

What the arm feels of a free base, and how the base gives way, is its inverse inertia times a force:
the likelihood of torque or rate is straight in the ten coordinates [1/m, centre of mass, inverse
central inertia], and bent in pi, where a sigma of a tenth of the mass already leaves squared
normalised errors of twice their share. The Gaussian is therefore taken in the base's mobility, the
other states as they are, and its second moment about the estimate is what is published in pi.

Source: the elimination of the base acceleration, paper eqs. (22)-(23); second moments of a mapped
Gaussian as in Julier, Uhlmann, Proc. IEEE 92 (2004), here from many fixed draws.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import solve_triangular

from fsw.estimators.inertia import from_parameters, report_jacobian
from fsw.messages import FloatArray
from fsw.stages import complete

DRAWS = 2000  # second moments good to 3 % where the mapping is bent, exact where it is straight
STRAIGHT = 1.05  # largest ratio of variances at which pi itself is straight enough
IMPOSSIBLE = 0.01  # share of draws without a body above which this is no description either
TORQUE = ("rda", "fused")  # methods whose likelihood is straight in the base's mobility
NOTE = "not Gaussian in the base's parameters; sigma mapped from its mobility"

_INDEX = ((0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2))  # xx xy xz yy yz zz
_PI_INDEX = ((0, 0, 1, 0, 1, 2), (0, 1, 1, 2, 2, 2))  # the last six of pi
_SYMMETRIC = ((0, 1, 2), (1, 3, 4), (2, 4, 5))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mapped:
    """The covariance by way of the mobility.

    `stretch`: largest variance over that of the linearisation, one where pi is straight.
    """

    covariance: FloatArray  # (p, p)
    stretch: float
    impossible: float  # share of draws that are no body

    @property
    def bent(self) -> bool:
        """Tell whether the linearisation in pi understates the covariance."""
        return self.stretch > STRAIGHT

    @property
    def holds(self) -> bool:
        """Tell whether nearly all of the Gaussian in the mobility are possible bodies."""
        return self.impossible <= IMPOSSIBLE


def to_mobility(pi: FloatArray) -> FloatArray:
    """Return [1/m, centre of mass, inverse central inertia xx xy xz yy yz zz] (10,) of pi."""
    m, c, central = from_parameters(pi)
    inverse = np.linalg.solve(central[np.array(_SYMMETRIC)], np.eye(3))
    return np.concatenate(([1.0 / m], c, inverse[_INDEX]))


def from_mobility(mobility: FloatArray) -> FloatArray:
    """Return pi (..., 10) of mobilities (..., 10); inverse of `to_mobility`."""
    central = np.linalg.solve(mobility[..., 4:][..., np.array(_SYMMETRIC)], np.eye(3))
    m, c = 1.0 / mobility[..., :1], mobility[..., 1:4]
    square = np.sum(c * c, axis=-1)[..., None, None] * np.eye(3)
    origin = central + m[..., None] * (square - c[..., :, None] * c[..., None, :])
    rows, columns = _PI_INDEX
    return np.concatenate([m, m * c, origin[..., rows, columns]], axis=-1)


def mobility_jacobian(pi: FloatArray) -> FloatArray:
    """Return d(mobility)/d pi, (10, 10)."""
    report = report_jacobian(pi)
    inverse = to_mobility(pi)[4:][np.array(_SYMMETRIC)]
    J = report.copy()
    J[0] = -report[0] / pi[0] ** 2
    for k in range(10):
        J[4:, k] = -(inverse @ report[4:, k][np.array(_SYMMETRIC)] @ inverse)[_INDEX]
    return J


def by_mobility(x: FloatArray, covariance: FloatArray, base: slice) -> Mapped:
    """Return the second moment about x (p,) of the Gaussian in the mobility of the ten `base`.

    The draws have exactly the covariance asked for, so what is straight comes back unchanged.
    """
    return complete(by_mobility_stages(x, covariance, base, DRAWS, DRAWS))


def by_mobility_stages(
    x: FloatArray, covariance: FloatArray, base: slice, draws: int, at_once: int
) -> Generator[None, None, Mapped]:
    """Do what `by_mobility` does with so many draws, in units of `at_once`."""
    p = len(x)
    scale = np.sqrt(np.diag(covariance))
    root = scale[:, None] * np.linalg.cholesky(covariance / np.outer(scale, scale))
    centre, slope = to_mobility(x[base]), mobility_jacobian(x[base]).T
    unit = _draws(p, draws)
    squares, possible = np.zeros((p, p)), 0
    yield
    for first in range(0, len(unit), at_once):
        straight = unit[first : first + at_once] @ root.T
        mobilities = centre + straight[:, base] @ slope
        central = mobilities[:, 4:][:, np.array(_SYMMETRIC)]
        kept = (mobilities[:, 0] > 0.0) & _inertias(central)
        bent = straight[kept]
        bent[:, base] = from_mobility(mobilities[kept]) - x[base]
        white = solve_triangular(root, bent.T, lower=True)
        squares += white @ white.T
        possible += int(np.sum(kept))
        yield
    ratio = squares / max(1, possible)
    return Mapped(
        covariance=root @ ratio @ root.T,
        stretch=float(np.linalg.eigvalsh(ratio)[-1]),
        impossible=1.0 - possible / len(unit),
    )


def _inertias(inverse: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Tell which of inverse central inertias (k, 3, 3) are those of a body.

    Principal moments positive and none above the sum of the other two.
    """
    values = np.linalg.eigvalsh(inverse)
    with np.errstate(divide="ignore"):
        moments = 1.0 / values
    positive = values[:, 0] > 0.0
    possible: np.ndarray[tuple[int], np.dtype[np.bool_]] = positive & (
        moments[:, 0] < moments[:, 1] + moments[:, 2]
    )
    return possible


@lru_cache(maxsize=4)
def _draws(p: int, draws: int) -> FloatArray:
    """Return fixed draws (k, p) in opposite pairs, with mean zero and covariance one exactly."""
    half = np.random.default_rng(p).standard_normal((max(draws // 2, 4 * p), p))
    both = np.concatenate([half, -half])
    root = np.linalg.cholesky(both.T @ both / len(both))
    white: FloatArray = solve_triangular(root, both.T, lower=True).T
    white.setflags(write=False)
    return white
