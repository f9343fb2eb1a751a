"""Covariance of fading noise at the nodes, against a simulation of the same noise."""

import numpy as np
import pytest
from numpy.polynomial import legendre
from scipy.signal import lfilter

from fsw.estimators.noise.fading import NEIGHBOURS, covariance_at_nodes

SAMPLES, NODES, WINDOWS = 60, 3, 40_000
T = (np.arange(SAMPLES) + 0.5) * (2.0 / SAMPLES) - 1.0


@pytest.mark.parametrize("fading", [0.0, 0.9, 0.98])
def test_own_nodes_and_those_of_neighbours_are_correlated_as_simulated(fading):
    rng = np.random.default_rng(1)
    fresh = np.sqrt(1.0 - fading**2) * rng.standard_normal(WINDOWS * SAMPLES)
    noise = lfilter([1.0], [1.0, -fading], fresh).reshape(WINDOWS, SAMPLES)
    fitted = legendre.legfit(T, noise.T, NODES - 1)
    nodes = legendre.legval(legendre.leggauss(NODES)[0], fitted)  # (windows, nodes)
    expected = nodes.T @ nodes / WINDOWS
    for far in range(1, NEIGHBOURS + 1):
        across = nodes[:-far].T @ nodes[far:] / (WINDOWS - far)
        expected += across + across.T
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    found = covariance_at_nodes(SAMPLES, NODES, fading)
    assert np.abs(found - expected).max() < 0.05 * scale.max()


def test_a_constant_is_known_as_well_as_the_long_run_variance_says():
    """Weighted as white noise wants it, a window's constant has (1 + a) / (1 - a) / k of it."""
    weights = legendre.leggauss(NODES)[1] / 2.0
    for fading in (0.0, 0.5, 0.9):
        variance = weights @ covariance_at_nodes(SAMPLES, NODES, fading) @ weights
        long_run = (1.0 + fading) / (1.0 - fading) / SAMPLES
        assert variance == pytest.approx(long_run, rel=0.02)
