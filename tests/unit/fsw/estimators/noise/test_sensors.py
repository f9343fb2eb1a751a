"""Noise that is correlated in time: found, and its covariance against a simulation."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial import legendre
from scipy.signal import lfilter

from fsw.estimators.noise.fading import covariance_at_nodes
from fsw.estimators.noise.found import mean_products
from fsw.estimators.noise.sensors import ChannelNoise, SensorNoise
from fsw.messages import Block, FloatArray
from tests.support.loop_cases import make_block

SAMPLES, NODES, STEP_S = 200, 4, 0.002
WINDOW_S = SAMPLES * STEP_S
DEGREE = NODES + 2  # of the polynomial that the conditioner fits to positions
T = (np.arange(SAMPLES) + 0.5) * (2.0 / SAMPLES) - 1.0


def noise(rng: np.random.Generator, windows: int, time_s: float, channels: int = 1) -> FloatArray:
    """Return stationary noise (windows, SAMPLES, channels) of unit variance."""
    a = np.exp(-STEP_S / time_s) if time_s else 0.0
    fresh = np.sqrt(1.0 - a * a) * rng.standard_normal((windows * SAMPLES, channels))
    start = a * rng.standard_normal((1, channels))
    faded = lfilter([1.0], [1.0, -a], fresh, axis=0, zi=start)[0]
    return np.asarray(faded).reshape(windows, SAMPLES, channels)


def block_of(values: FloatArray, index: int = 0) -> Block:
    """Return a block whose torque sensors showed these values (SAMPLES, n)."""
    left = values - legendre.legval(T, legendre.legfit(T, values, DEGREE)).T
    made = make_block(index, joints=values.shape[1], nodes=NODES)
    return replace(made, tau_products_nm2=mean_products(left), has_gyro=True)


def judged(values: FloatArray, declared_nm: float = 1.0) -> SensorNoise:
    """Return what values (windows, SAMPLES, n) tell of the noise."""
    n = values.shape[2]
    found = SensorNoise(np.full(n + 2, declared_nm), np.full(n + 2, SAMPLES), WINDOW_S, NODES)
    for k, window in enumerate(values):
        found.note(block_of(window, k))
    return found


def test_what_the_model_leaves_out_is_not_counted_twice():
    """Declared larger than found: the blocks hold it already. Smaller: the found one holds."""
    values = 0.3 * noise(np.random.default_rng(5), 400, 0.05)
    fading = float(np.exp(-STEP_S / 0.05))
    at_nodes = covariance_at_nodes(SAMPLES, NODES, fading)
    totals = []
    for sigma in (0.0, 0.1, 0.6):
        counted = sigma**2 * at_nodes[None]
        found = SensorNoise(np.full(3, 0.01), np.full(3, SAMPLES), WINDOW_S, NODES, counted)
        for k, window in enumerate(values):
            found.note(block_of(window, k))
        found.learn()
        block = make_block(3, joints=1, nodes=NODES)
        own = replace(block, cov_tau=counted.copy(), has_joint=np.array([True]))
        totals.append(found.applied(own).cov_tau[0])
    assert np.allclose(totals[1], totals[0], rtol=1e-9)
    assert np.allclose(totals[2], 0.6**2 * at_nodes, rtol=1e-9)
    assert np.trace(totals[0]) > 0.1**2 * np.trace(at_nodes)


@pytest.mark.parametrize("windows", [4, 40, 160])
def test_white_noise_stays_as_declared_to_the_bit(windows):
    rng = np.random.default_rng(windows)
    for _ in range(40):
        found = judged(noise(rng, windows, 0.0, channels=7))
        assert not found.learn()
        assert all(channel.is_white for channel in found.channels)
        block = make_block(3, joints=7, nodes=NODES)
        assert found.applied(block) is block
    sigmas = [channel.sigma for channel in found.channels[:7]]
    assert np.abs(np.array(sigmas) - 1.0).max() < 5.0 / np.sqrt(2 * windows * SAMPLES)


def test_noise_larger_than_declared_but_white_is_reported_and_left_to_the_residuals():
    found = judged(3.0 * noise(np.random.default_rng(2), 40, 0.0))
    assert not found.learn()
    assert found.channels[0].sigma == pytest.approx(3.0, rel=0.03)
    assert found.channels[0].declared == 1.0


@pytest.mark.parametrize("time_s", [0.005, 0.02, 0.05])
def test_size_time_and_effective_samples_are_found(time_s):
    found = judged(0.3 * noise(np.random.default_rng(3), 400, time_s))
    assert found.learn()
    channel = found.channels[0]
    a = np.exp(-STEP_S / time_s)
    assert channel.sigma == pytest.approx(0.3, rel=0.15)
    assert channel.correlation_s == pytest.approx(time_s, rel=0.4)
    # Box, Jenkins: the mean of an autoregression is worth (1 - a) / (1 + a) of its samples
    expected = channel.samples * (1.0 - a) / (1.0 + a)
    assert channel.effective_samples == pytest.approx(expected, rel=0.5)


@pytest.mark.parametrize(("time_s", "white"), [(0.02, 0.0), (0.02, 1.0), (0.005, 0.5), (0.05, 0.5)])
def test_the_covariance_at_the_nodes_is_that_of_many_windows_together(time_s, white):
    """Values at the nodes summed over sixteen windows in a row, a thousand times, simulated."""
    rng = np.random.default_rng(4)
    runs, row = 1000, 16
    values = noise(rng, row, time_s, runs) + white * rng.standard_normal((row, SAMPLES, runs))
    nodes = legendre.leggauss(NODES)[0]
    at_nodes = [legendre.legval(nodes, legendre.legfit(T, w, NODES - 1)) for w in values]
    sums = np.sum(at_nodes, axis=0)  # (runs, NODES)
    simulated = sums.T @ sums / runs / row
    known = noise(rng, 4000, time_s) + white * rng.standard_normal((4000, SAMPLES, 1))
    found = judged(known, declared_nm=0.7)
    assert found.learn()
    declared = replace(make_block(1, joints=1, nodes=NODES), cov_tau=_white(0.7)[None])
    covariance = found.applied(declared).cov_tau[0]
    ratios = np.linalg.eigvals(np.linalg.solve(simulated, covariance)).real
    assert ratios.min() > 0.75
    assert ratios.max() < 1.35
    # what white samples of that sigma would leave is far off, or this would show nothing
    naive = _white(np.sqrt(1.0 + white**2))
    assert np.linalg.eigvals(np.linalg.solve(simulated, naive)).real.min() < 0.5


def _white(sigma: float) -> FloatArray:
    """Return the covariance at the nodes of a polynomial through white samples."""
    nodes = legendre.leggauss(NODES)[0]
    V, at = legendre.legvander(T, NODES - 1), legendre.legvander(nodes, NODES - 1)
    return np.asarray(sigma**2 * at @ np.linalg.inv(V.T @ V) @ at.T)


def inertial_block(gyro: FloatArray, acc: FloatArray) -> Block:
    """Return a block whose inertial unit showed these values (SAMPLES, 3)."""
    products = [block_of(values).tau_products_nm2.mean(axis=1) for values in (gyro, acc)]
    made = replace(make_block(1, joints=1, nodes=NODES), imu_products=np.stack(products, axis=1))
    return replace(made, has_gyro=True, has_accelerometer=True)


@pytest.mark.parametrize(("time_s", "white"), [(0.02, 0.0), (0.02, 1.0), (0.05, 0.5)])
def test_rate_and_its_derivative_are_as_uncertain_as_many_windows_together(time_s, white):
    """Sums over sixteen windows in a row, of values and of derivatives, simulated."""
    rng = np.random.default_rng(14)
    runs, row = 1000, 16
    values = noise(rng, row, time_s, runs) + white * rng.standard_normal((row, SAMPLES, runs))
    nodes, total = legendre.leggauss(NODES)[0], np.zeros((2 * NODES, runs))
    for window in values:
        fit = legendre.legfit(T, window, NODES - 1)
        slope = legendre.legder(fit) * 2.0 / WINDOW_S
        total += np.hstack([legendre.legval(nodes, fit), legendre.legval(nodes, slope)]).T
    simulated = total @ total.T / runs / row
    known = noise(rng, 600, time_s, 3) + white * rng.standard_normal((600, SAMPLES, 3))
    found = SensorNoise(np.array([1.0, 0.7, 1.0]), np.full(3, SAMPLES), WINDOW_S, NODES)
    for window in known:
        found.note(inertial_block(window, rng.standard_normal((SAMPLES, 3))))
    assert found.learn()
    assert [channel.is_white for channel in found.channels] == [True, False, True]
    V = legendre.legvander(T, NODES - 1)
    slopes = legendre.legval(nodes, legendre.legder(np.eye(NODES))).T * 2.0 / WINDOW_S
    E = np.vstack([legendre.legvander(nodes, NODES - 1), slopes])
    declared = 0.7**2 * E @ np.linalg.inv(V.T @ V) @ E.T
    block = replace(inertial_block(known[0], known[0]), cov_gyro=declared)
    covariance = found.applied(block).cov_gyro
    kept = np.linalg.svd(E)[0][:, :NODES]  # a cubic has four values, not eight
    simulated, covariance = (kept.T @ C @ kept for C in (simulated, covariance))
    ratios = np.linalg.eigvals(np.linalg.solve(simulated, covariance)).real
    assert ratios.min() > 0.7
    assert ratios.max() < 1.4
    assert found.applied(block).cov_acc is not None
    assert np.array_equal(found.applied(block).cov_acc, block.cov_acc)


def test_an_inertial_unit_that_is_missing_stays_missing():
    rng = np.random.default_rng(15)
    found = judged(noise(rng, 2, 0.0))
    coloured = noise(rng, 200, 0.02, 6)
    for window in coloured:
        found.note(inertial_block(window[:, :3], window[:, 3:]))
    assert found.learn()
    blind = replace(make_block(1, joints=1, nodes=NODES), has_gyro=False, has_accelerometer=False)
    assert found.applied(blind).cov_gyro is blind.cov_gyro
    assert found.applied(blind).cov_acc is blind.cov_acc
    report = found.report({"joint1": "N m"}, 1)
    assert [own["channel"] for own in report["inertial_noise"]] == ["gyro", "accelerometer"]
    assert report["inertial_noise"][0]["samples"] == 3 * 200 * SAMPLES
    assert "gyro 1" in found.words({"joint1": "N m"})


def test_only_the_sensors_concerned_change_and_a_missing_one_stays_missing():
    rng = np.random.default_rng(5)
    values = np.concatenate([noise(rng, 40, 0.0, 2), noise(rng, 40, 0.02, 2)], axis=2)
    found = judged(values)
    assert found.learn()
    assert [channel.is_white for channel in found.channels[:4]] == [True, True, False, False]
    block = replace(
        make_block(1, joints=4, nodes=NODES), has_joint=np.array([True, True, True, False])
    )
    added = found.applied(block).cov_tau - block.cov_tau
    assert [bool(matrix.any()) for matrix in added] == [False, False, True, False]
    assert np.linalg.eigvalsh(added[2] + _white(1.0)).min() > 0.0


def test_torque_sensors_alike_share_a_time_and_one_that_differs_keeps_its_own():
    """Sizes stay their own; a sensor that is five times as slow is not taken as the others."""
    rng = np.random.default_rng(21)
    alike, odd = noise(rng, 150, 0.02, 6), noise(rng, 150, 0.1, 1)
    found = judged(np.concatenate([alike * np.arange(1.0, 7.0), odd], axis=2))
    assert found.learn()
    *same, other = found.channels[:7]
    times_s = [channel.correlation_s for channel in same]
    assert len(set(times_s)) == 1
    assert times_s[0] == pytest.approx(0.02, rel=0.15)
    assert [c.sigma for c in same] == pytest.approx(list(np.arange(1.0, 7.0)), rel=0.1)
    assert other.correlation_s > 0.05


def test_correlated_noise_smaller_than_declared_keeps_the_declared_size():
    """As of a sensor that shows nothing but its quantisation: subtracting left no covariance."""
    rng = np.random.default_rng(8)
    small, declared = judged(1e-6 * noise(rng, 40, 0.02)), judged(noise(rng, 400, 0.02))
    assert small.learn()
    assert declared.learn()
    block = replace(make_block(1, joints=1, nodes=NODES), cov_tau=_white(1.0)[None])
    covariance = small.applied(block).cov_tau[0]
    assert np.linalg.eigvalsh(covariance).min() > np.linalg.eigvalsh(_white(1.0)).min()
    ratios = np.linalg.eigvals(np.linalg.solve(declared.applied(block).cov_tau[0], covariance)).real
    assert 0.5 < ratios.min() <= ratios.max() < 2.0


def test_a_small_change_is_no_reason_to_begin_again_and_a_large_one_is():
    rng = np.random.default_rng(6)
    found = judged(noise(rng, 200, 0.02))
    assert found.learn()
    for k, window in enumerate(noise(rng, 5, 0.02)):
        found.note(block_of(window, k))
    assert not found.learn()
    for k, window in enumerate(4.0 * noise(rng, 200, 0.02)):
        found.note(block_of(window, k))
    assert found.learn()


def test_a_state_is_continued():
    values = noise(np.random.default_rng(7), 40, 0.02)
    found, other = judged(values), judged(values[:0].reshape(0, SAMPLES, 1))
    found.learn()
    other.restore(found.snapshot())
    assert other.channels == found.channels
    block = make_block(1, joints=1, nodes=NODES)
    assert np.array_equal(other.applied(block).cov_tau, found.applied(block).cov_tau)
    assert other.snapshot().keys() == found.snapshot().keys()


def test_windows_that_say_nothing_are_not_counted():
    found = judged(np.zeros((3, SAMPLES, 1)))
    assert not found.learn()
    assert found.channels == (ChannelNoise(1.0, 1.0, 1.0, 0.0, 0, 0.0),) * 3
    found.note(replace(make_block(1, joints=1, nodes=NODES), tau_products_nm2=np.zeros((1, 1))))
    assert found.channels[0].samples == 0
