"""What a window's polynomial leaves out of a joint's motion.

The Legendre coefficients of a smooth motion fall with their degree. The two highest of a fit, over
the two before them, show how fast; the first two that the fit lacks are taken to fall as fast. They
are errors of the motion besides noise, unknown and of this size. Coefficients that the noise of
the samples explains show nothing. Where a motion is not smooth, as where it starts within a window,
they need not fall; then what the fit leaves of the samples beyond their noise is the size of what
is left out: what they have in common with the next sample's. A motion that is too fast for its
window thereby has an error that says so.
"""

from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre

from fsw.estimators.conditioning.polynomial import gauss_nodes
from fsw.messages import FloatArray

OMITTED = 2  # coefficients: an odd and an even one
SIGMAS = 2.0  # of a coefficient's noise, which explains a smaller one
POWER_SIGMAS = 4.0  # of a mean product of residuals, likewise


@lru_cache(maxsize=16)
def legendre_basis(nodes: int, degree: int, half_s: float) -> FloatArray:
    """Return (3, m, degree + 1): Legendre basis of [qd, qdd, q] at m Gauss nodes of a window."""
    at, unit = gauss_nodes(nodes), np.eye(degree + 1)
    basis = np.stack(
        [
            np.stack([legendre.legval(at, legendre.legder(one, order)) for one in unit], axis=1)
            / half_s**order
            for order in (1, 2, 0)
        ]
    )
    basis.setflags(write=False)
    return basis


@lru_cache(maxsize=16)
def coefficients(nodes: int, degree: int, half_s: float) -> FloatArray:
    """Return (degree + 1, 3, m), which maps [qd, qdd, q] at m nodes to q's Legendre coefficients.

    This is exact for polynomials of the degree, which is at most 3 m - 1.
    """
    scale = np.array([half_s, half_s**2, 1.0])[:, None, None]
    unit = legendre_basis(nodes, degree, half_s) * scale
    inverse = np.linalg.pinv(unit.reshape(3 * nodes, -1)).reshape(-1, 3, nodes)
    found: FloatArray = inverse * scale[:, :, 0]
    found.setflags(write=False)
    return found


def omitted(
    motion: FloatArray,
    degree: int,
    half_s: float,
    sigma: FloatArray,
    samples: int,
    left: FloatArray,
) -> FloatArray:
    """Return the covariance (n, 3 m, 3 m) of [qd, qdd, q] due to what the fits of n joints omit.

    Parameters
    ----------
    motion : (3, m, n) [qd, qdd, q] at the nodes, polynomials of a `degree`
    half_s : half the window [s]
    sigma : (n,) noise of a sample of the position [rad]
    samples : number of samples in the window
    left : (2, n) mean products of residuals of the fits, 0 and 1 samples apart [rad^2]
    """
    m = motion.shape[1]
    of = coefficients(m, degree, half_s)[-4:]
    size = np.abs(np.einsum("cdi,din->cn", of, motion))
    white = np.sqrt(np.maximum(sigma**2, left[0] - left[1]))  # also if more than declared
    noise = SIGMAS * white * np.sqrt((2 * np.arange(degree - 1, degree + 1)[:, None] + 1) / samples)
    beyond = np.sqrt(np.sum(np.maximum(size[2:] ** 2 - noise**2, 0.0), axis=0))
    falling = np.minimum(1.0, size[2:].sum(axis=0) / np.maximum(size[:2].sum(axis=0), 1e-300))
    power = np.maximum(left[1] - white**2 * (1.0 + POWER_SIGMAS / np.sqrt(samples)), 0.0)
    square = np.maximum((falling * beyond) ** 2, (2 * (degree + OMITTED) + 1) * power)
    phi = legendre_basis(m, degree + OMITTED, half_s)[:, :, -OMITTED:].reshape(3 * m, OMITTED)
    found: FloatArray = square[:, None, None] * (phi @ phi.T)
    return found
