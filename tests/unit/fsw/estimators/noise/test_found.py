"""Mean products of residuals against plain sums; noise found in them against what made it."""

import tracemalloc

import numpy as np
import pytest
from numpy.polynomial import legendre
from scipy.signal import lfilter

from fsw.estimators.noise.fading import covariance_at_nodes
from fsw.estimators.noise.found import (
    LAGS,
    found_noise,
    gapped_products,
    mean_products,
    shapes_of,
    shared_fading,
)
from fsw.messages import FloatArray

SAMPLES, NODES = 200, 4
FEW, WINDOWS, SENSORS = 40, 150, 7  # a minute at 100 Hz


def test_mean_products_are_those_of_a_plain_sum():
    rng = np.random.default_rng(1)
    left = rng.standard_normal((SAMPLES, 2))
    products = mean_products(left)
    for row, lag in enumerate(LAGS):
        plain = sum(left[k + lag] * left[k] for k in range(SAMPLES - lag)) / SAMPLES
        assert np.allclose(products[row], plain, rtol=1e-12)


def test_products_of_samples_of_which_some_are_lost_are_those_of_the_known_pairs():
    rng = np.random.default_rng(4)
    left = rng.standard_normal((SAMPLES, 2))
    known = rng.random(SAMPLES) > 0.2
    known[[0, -1]] = True
    products = gapped_products(left[known], np.flatnonzero(known))
    for row, lag in enumerate(LAGS):
        pairs = [left[k + lag] * left[k] for k in range(SAMPLES - lag) if known[k] & known[k + lag]]
        share = (SAMPLES - lag) / SAMPLES
        assert np.allclose(products[row], share * np.mean(pairs, axis=0), rtol=1e-12)
    assert np.allclose(gapped_products(left, np.arange(SAMPLES)), mean_products(left), rtol=1e-12)


@pytest.mark.parametrize(("samples", "nodes"), [(8, 2), (30, 4), (200, 8)])
def test_shapes_are_those_of_the_whole_covariance(samples, nodes):
    shapes = shapes_of(samples, nodes)
    T = (np.arange(samples) + 0.5) * (2.0 / samples) - 1.0
    basis = legendre.legvander(T, nodes + 2)
    rest = np.eye(samples) - basis @ np.linalg.pinv(basis)
    for a, found in zip(shapes.fading, shapes.faded, strict=True):
        C = a ** np.abs(np.subtract.outer(np.arange(samples), np.arange(samples)))
        left = rest @ C @ rest
        assert np.allclose(found, [np.trace(left, lag) / samples for lag in LAGS], atol=1e-12)
    assert np.allclose(shapes.white, [np.trace(rest, lag) / samples for lag in LAGS], atol=1e-12)


def test_shapes_of_many_samples_need_no_covariance_of_all():
    tracemalloc.start()
    shapes_of(5000, NODES)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 20e6  # bytes; a matrix of 5000 by 5000 has 200e6


def test_products_that_no_noise_has_are_taken_as_white():
    alternating = np.array([(-1.0) ** lag for lag in LAGS])
    assert found_noise(alternating, 100, SAMPLES, NODES) is None


def fading_products(rng: np.random.Generator, times: FloatArray) -> FloatArray:
    """Return mean products (L, J) of a minute of noise of unit variance, times (J,) in samples."""
    T = (np.arange(FEW) + 0.5) * (2.0 / FEW) - 1.0
    columns = []
    for time in times:
        a = np.exp(-1.0 / time)
        fresh = np.sqrt(1.0 - a * a) * rng.standard_normal(FEW * WINDOWS + 300)
        values = lfilter([1.0], [1.0, -a], fresh)[300:].reshape(WINDOWS, FEW).T
        left = values - legendre.legval(T, legendre.legfit(T, values, NODES + 2)).T
        columns.append(mean_products(left).mean(axis=1))
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("time", [1.2, 2.0])
def test_the_information_that_is_counted_is_on_the_mean_what_there_is(time):
    """Of a constant. Each sensor by itself counts 5 and 7 % too little: errors are lopsided."""
    rng = np.random.default_rng(3)
    windows = np.full(SENSORS, WINDOWS)

    def information(white: float, fading: float, k: int) -> float:
        at_nodes = shapes_of(FEW, NODES).at_nodes[[0, k + 1], :NODES, :NODES]
        return float(np.linalg.inv(white * at_nodes[0] + fading * at_nodes[1]).sum())

    counted, alone = [], []
    for _ in range(40):
        products = fading_products(rng, np.full(SENSORS, time))
        shared = shared_fading(products, windows, FEW, NODES)
        own = [found_noise(column, WINDOWS, FEW, NODES) for column in products.T]
        best = [s or o for s, o in zip(shared, own, strict=True)]
        counted += [information(*found) for found in best if found is not None]
        alone += [information(*found) for found in own if found is not None]
    true = np.linalg.inv(covariance_at_nodes(FEW, NODES, float(np.exp(-1.0 / time)))).sum()
    assert len(counted) == 40 * SENSORS
    assert 0.95 < np.mean(counted) / true < 1.05
    assert np.std(counted) < 0.7 * np.std(alone)


def test_a_sensor_that_is_unlike_the_others_is_told():
    rng = np.random.default_rng(4)
    windows = np.full(SENSORS, WINDOWS)
    for _ in range(10):
        products = fading_products(rng, np.array([2.0] * (SENSORS - 1) + [6.0]))
        *others, odd = shared_fading(products, windows, FEW, NODES)
        assert odd is None
        assert sum(found is not None for found in others) >= SENSORS - 3
