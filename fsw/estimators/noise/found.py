"""Size and fading of noise, found from the mean products of residuals.

A window's polynomial removes part of the noise with the motion. The products are therefore compared
with those that it leaves of white noise, and of noise with each of TIMES correlation times.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.linalg import matmul_toeplitz

from fsw.estimators.conditioning.polynomial import EXTRA_DEGREE
from fsw.estimators.noise.fading import covariance_at_nodes, instants
from fsw.messages import FloatArray

LAGS = (0, 1, 2, 3, 5, 8, 12, 18, 27, 40)  # samples between the factors of a mean product
TIMES = 31  # number of compared correlation times, from one sample to a quarter of the window
SIGNIFICANT = 50.0  # (fall of misfit) x samples that white noise reaches once in 1e10 sets
UNLIKE = 6.0  # rise of the misfit over chance at which a sensor does not share the fading
LEAST_INFLATION = 1.1  # least factor on the variance that is worth a change

Found = tuple[float, float, int]  # variance of white and of fading part, index of correlation time


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """Effect of noise of unit variance in a window, for T correlation times.

    Attributes
    ----------
    fading : (T,) correlation of successive samples
    white, faded : (L,) and (T, L) expected mean products of residuals after the polynomial's fit
    at_nodes : (T + 1, 2 m, 2 m) covariance at the nodes of values and of derivatives by the time in
        half windows; white noise first
    """

    fading: FloatArray
    white: FloatArray
    faded: FloatArray
    at_nodes: FloatArray


@lru_cache(maxsize=8)
def shapes_of(samples: int, nodes: int) -> Shapes:
    """Return the shapes for windows of `samples` samples and blocks of `nodes` nodes."""
    removed = np.linalg.qr(legendre.legvander(instants(samples), nodes - 1 + EXTRA_DEGREE))[0]
    place = np.arange(samples)
    fading = np.exp(-1.0 / np.geomspace(1.0, samples / 4.0, TIMES))
    products, at_nodes = [], []
    for a in (0.0, *fading.tolist()):
        # R = removed, C the samples' covariance: the residuals' is C - R half^T - half R^T
        half = matmul_toeplitz(a**place, removed)
        half = half - 0.5 * removed @ (removed.T @ half)
        products.append([_trace_left(removed, half, a, lag) / samples for lag in LAGS])
        at_nodes.append(covariance_at_nodes(samples, nodes, a, derivatives=True))
    white, faded = np.array(products[0]), np.array(products[1:])
    return Shapes(fading, white, faded, np.array(at_nodes))


def _trace_left(removed: FloatArray, half: FloatArray, fading: float, lag: int) -> float:
    """Return the sum of diagonal `lag` of the residuals' covariance after the polynomial's fit."""
    pairs = max(0, len(removed) - lag)
    across = np.vdot(removed[:pairs], half[lag:]) + np.vdot(half[:pairs], removed[lag:])
    return float(pairs * fading**lag - across)


def mean_products(residuals: FloatArray) -> FloatArray:
    """Return the mean products (L, n) of residuals (k, n), LAGS samples apart."""
    k, n = residuals.shape
    later = np.zeros((n, k + LAGS[-1]))
    later[:, :k] = residuals.T
    shifted = np.stack([later[:, lag : lag + k] for lag in LAGS], axis=1)  # (n, L, k)
    return np.asarray((shifted @ later[:, :k, None])[:, :, 0].T / k)


def gapped_products(residuals: FloatArray, place: NDArray[np.int64]) -> FloatArray:
    """Return `mean_products` of samples some of which are missing.

    Parameters
    ----------
    residuals : (k, n)
    place : (k,) period number of each sample, ascending
    """
    k = int(place[-1] - place[0]) + 1
    whole, known = np.zeros((k, residuals.shape[1])), np.zeros(k, np.bool_)
    whole[place - place[0]], known[place - place[0]] = residuals, True
    share = np.zeros(len(LAGS))
    for row, lag in enumerate(LAGS):
        pairs = np.count_nonzero(known[lag:] & known[: max(0, k - lag)])
        share[row] = (k - lag) / pairs if pairs else 0.0
    return np.asarray(mean_products(whole) * share[:, None])


def found_noise(products: FloatArray, windows: int, samples: int, nodes: int) -> Found | None:
    """Return the variances of the white and fading part, and the index of the correlation time.

    None: the products agree with white noise.

    Parameters
    ----------
    products : (L,) mean products of residuals, over `windows` windows of `samples` samples each
    """
    shapes = shapes_of(samples, nodes)
    y = products / products[0]
    white, fading, gain = _fits(shapes, y)
    gain_of_white = _gain(shapes.white, y)
    k = int(np.argmax(gain))
    if fading[k] == 0.0 or (gain[k] - gain_of_white) * windows * samples < SIGNIFICANT:
        return None
    at_white, at_faded = (size_at_nodes(C, nodes) for C in shapes.at_nodes[[0, k + 1]])
    total = white[k] + fading[k]
    if white[k] * at_white + fading[k] * at_faded < LEAST_INFLATION * total * at_white:
        return None
    return float(products[0] * white[k]), float(products[0] * fading[k]), k


def _fits(shapes: Shapes, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the white part, the fading part and the gain (T,) of a fit to products y (L,).

    The parts fit by least squares and are not negative. The gain is the fall of y's sum of squares.
    """
    a, F = shapes.white, shapes.faded
    aa, ff, af, ay, fy = a @ a, np.sum(F * F, axis=1), F @ a, a @ y, F @ y
    fading = np.maximum(0.0, (aa * fy - af * ay) / (aa * ff - af**2))
    white = (ay - fading * af) / aa
    fading = np.where(white < 0.0, np.maximum(0.0, fy / ff), fading)
    white = np.maximum(0.0, white)
    gain = 2.0 * (white * ay + fading * fy)
    gain -= white**2 * aa + 2.0 * white * fading * af + fading**2 * ff
    return white, fading, gain


def _gain(shape: FloatArray, y: FloatArray) -> float:
    """Return the fall of y's sum of squares if a shape (L,) of free size is fitted to y (L,)."""
    return float((shape @ y) ** 2 / (shape @ shape))


def shared_fading(
    products: FloatArray, windows: NDArray[np.int64], samples: int, nodes: int
) -> list[Found | None]:
    """Return the noise of coloured sensors (J) that share a fading; None for one that does not.

    Chance makes a sensor's own fit better than the shared shape, by an amount that follows from the
    correlations of such noise (Bartlett, J. R. Statist. Soc. Suppl. 8 (1946) 27). The sensor
    farthest beyond this amount is removed until the rest are alike.

    Parameters
    ----------
    products : (L, J) mean products of residuals, each over `windows` (J,) of `samples` samples
    """
    shapes, y = shapes_of(samples, nodes), products / products[0]
    best = np.array([_fits(shapes, own)[2].max() for own in y.T])
    found: list[Found | None] = [None] * len(windows)
    left = np.arange(len(windows))
    while len(left) > 1:
        count = int(windows[left].sum())
        together = found_noise(y[:, left] @ windows[left] / count, count, samples, nodes)
        if together is None:
            break
        white, fading, k = together
        shape = white * shapes.white + fading * shapes.faded[k]
        a = shapes.fading[k]
        chance = (1.0 + a**2) / (1.0 - a**2) / (windows * samples)
        unlike = np.array([(best[j] - _gain(shape, y[:, j])) / chance[j] for j in left])
        if unlike.max() < UNLIKE:
            for j in left.tolist():
                size = float(products[0, j] * (y[:, j] @ shape) / (shape @ shape))
                found[j] = size * white, size * fading, k
            break
        left = np.delete(left, unlike.argmax())
    return found


def size_at_nodes(covariance: FloatArray, nodes: int) -> float:
    """Return the sum of the variances of values at the nodes, without those of derivatives."""
    return float(np.trace(covariance[:nodes, :nodes]))
