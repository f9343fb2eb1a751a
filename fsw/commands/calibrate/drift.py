"""A constant with white noise and a random walk on it, from means over equal windows.

The error of a mean over a recording at rest is that of the white noise and that of the walk: the
value drifts within the recording, so the mean is not the value of any one moment.
"""

from dataclasses import dataclass

import numpy as np
from scipy.fft import dst

from fsw.messages import FloatArray

LEAST_WINDOWS = 8
RATIOS = np.concatenate([[0.0], np.logspace(-8.0, 3.0, 221)])  # walk over white that are compared


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drift:
    """Mean of k channels alike, and how far it may be from the value at one moment."""

    mean: FloatArray  # (k,)
    sigma: float
    white: float  # 1 sigma of a window's mean by white noise
    walk: float  # 1 sigma by which the value walks from window to window; 0: none is seen


def drift(means: FloatArray, white_sigma: float) -> Drift:
    """Return the mean of each column, and its 1 sigma by white noise and walk together.

    The differences of neighbouring means of white noise of variance a and a walk of variance q per
    window have the covariance tridiag(q/6 - a, 2 a + 2 q/3, q/6 - a). The sine transform makes it
    diagonal, so the likelihood is exact. The walk is taken as large as the data allow, at the upper
    end of its 68 % interval of likelihood: a short recording cannot rule a slow one out.
    Source of the walk's averages: IEEE Std 952, annex C; of the eigenvalues: Smith, Numerical
    Solution of PDEs (1985), p. 154.

    Parameters
    ----------
    means : (n, k) means over n windows in order; n at least LEAST_WINDOWS
    white_sigma : 1 sigma of a window's mean, declared; the white noise is not taken as less
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
