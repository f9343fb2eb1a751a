"""The mean of a channel at rest against known noise: its sigma holds white noise and walk."""

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.stats import multivariate_normal

from offline.calibrate.drift import RATIOS, drift

SEEDS, WINDOWS, SAMPLES = 300, 60, 20


def readings(rng: np.random.Generator, white: float, walk: float) -> np.ndarray:
    """Means over windows of samples with noise `white`, on a walk of `walk` per window from 0."""
    n = WINDOWS * SAMPLES
    steps = walk / SAMPLES**0.5 * rng.standard_normal((n, 1))
    samples = np.cumsum(steps, axis=0) + white * SAMPLES**0.5 * rng.standard_normal((n, 1))
    return samples.reshape(WINDOWS, SAMPLES).mean(axis=1, keepdims=True)


@pytest.mark.parametrize(("white", "walk"), [(1.0, 0.0), (1.0, 0.03), (1.0, 0.3), (0.1, 1.0)])
def test_the_sigma_holds_the_distance_from_the_value_at_the_start(white, walk):
    rng = np.random.default_rng(1)
    found = [drift(readings(rng, white, walk), white) for _ in range(SEEDS)]
    off = np.array([one.mean[0] for one in found])
    sigma = np.array([one.sigma for one in found])
    true = np.hypot(white / WINDOWS**0.5, walk * (WINDOWS / 3.0) ** 0.5)
    assert np.sqrt(np.mean((off / sigma) ** 2)) < 1.1
    assert np.median(sigma) < 4.0 * true  # sixty windows do not rule out a walk of this size


def test_the_likelihood_is_that_of_the_exact_covariance():
    values = readings(np.random.default_rng(2), 1.0, 0.5)
    found, steps = drift(values, 1e-9), np.diff(values[:, 0])
    whites, costs = [], []
    for ratio in RATIOS:
        row = [2.0 + 2.0 * ratio / 3.0, ratio / 6.0 - 1.0, *[0.0] * (len(steps) - 2)]
        shape = toeplitz(row)
        white = steps @ np.linalg.solve(shape, steps) / len(steps)
        whites.append(white)
        costs.append(-2.0 * multivariate_normal.logpdf(steps, cov=white * shape))
    best, most = np.argmin(costs), np.flatnonzero(costs <= np.min(costs) + 1.0)[-1]
    assert found.white**2 == pytest.approx(whites[best], rel=1e-6)
    assert found.walk**2 == pytest.approx(RATIOS[most] * whites[most], rel=1e-6)


def test_the_white_noise_is_at_least_the_declared_one():
    found = drift(np.full((WINDOWS, 3), 2.0), 0.5)
    assert found.mean.tolist() == [2.0, 2.0, 2.0]
    assert found.sigma == pytest.approx(0.5 / WINDOWS**0.5)
