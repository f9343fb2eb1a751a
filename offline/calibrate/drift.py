"""Estimate a constant with white noise and a random walk, from means over equal windows.

The mean over a recording at rest has two errors: that of the white noise, and that of the random
walk, because the value drifts and the mean is not the value at a given moment.
"""

from dataclasses import dataclass

import numpy as np
from scipy.fft import dst

from fsw.messages import FloatArray

LEAST_WINDOWS = 8
RATIOS = np.concatenate([[0.0], np.logspace(-8.0, 3.0, 221)])  # tried ratios of variances q / a


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drift:
    """Mean of k channels with equal noise, and its error if used as the value at one moment."""

    mean: FloatArray  # (k,)
    sigma: float  # 1 sigma of each mean, from white noise and random walk
    white: float  # 1 sigma of a window's mean, from white noise
    walk: float  # 1 sigma of the random walk's step from window to window


def drift(means: FloatArray, white_sigma: float) -> Drift:
    """Return the mean of each column, and its 1 sigma from white noise and random walk.

    Let a be the variance of the white noise and q that of the random walk per window. Differences
    of neighbouring means have the covariance tridiag(q/6 - a, 2 a + 2 q/3, q/6 - a). The sine
    transform makes it diagonal, so the likelihood is exact. The result uses the upper end of the
    68 % likelihood interval of q, because a short recording cannot exclude a slow random walk.
    Source of the averages of a walk: IEEE Std 952, annex C; of the eigenvalues: Smith, Numerical
    Solution of PDEs (1985), p. 154.

    Parameters
    ----------
    means : (n, k) means over n windows in order; n at least LEAST_WINDOWS
    white_sigma : declared 1 sigma of a window's mean; lower bound of the white noise
    """
    n, k = means.shape
    squares = np.sum(dst(np.diff(means, axis=0), type=1, norm="ortho", axis=0) ** 2, axis=1)
    cosine = np.cos(np.pi * np.arange(1, n) / n)
    shape = 2.0 - 2.0 * cosine + RATIOS[:, None] * (2.0 + cosine) / 3.0  # (ratios, n - 1)
    white = np.maximum(np.mean(squares / shape, axis=1) / k, 1e-300)
    cost = k * ((n - 1) * np.log(white) + np.sum(np.log(shape), axis=1))
    likely = np.flatnonzero(cost <= cost.min() + 1.0)
    most = int(likely[-1])
    white_variance = max(float(white[int(np.argmin(cost))]), white_sigma**2)
    walk_variance = float(RATIOS[most] * white[most])
    return Drift(
        mean=np.asarray(means.mean(axis=0), np.float64),
        sigma=float(np.sqrt(white_variance / n + walk_variance * n / 3.0)),
        white=float(np.sqrt(white_variance)),
        walk=float(np.sqrt(walk_variance)),
    )
