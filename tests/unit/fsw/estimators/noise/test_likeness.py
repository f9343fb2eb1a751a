"""Residuals that are alike: the covariance of least squares with noise that fades, simulated."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2

from fsw.estimators.noise.likeness import Likeness, besides_torques, lasting, likeness, widened
from fsw.estimators.recursive.trust import Trust

BLOCKS, NODES, JOINTS, P = 100, 4, 3, 6
COUNT = BLOCKS * NODES


def noise(rng: np.random.Generator, fading: float) -> np.ndarray:
    """Return autoregressive noise (COUNT, JOINTS) of unit variance."""
    fresh = rng.standard_normal((COUNT + 400, JOINTS))
    made = lfilter([1.0], [1.0, -fading], np.sqrt(1.0 - fading**2) * fresh, axis=0)
    return np.asarray(made[400:])


def regressors(rng: np.random.Generator) -> np.ndarray:
    """Return slow and fast columns (COUNT, JOINTS, P), as gravity and accelerations give them."""
    t = np.arange(COUNT) / COUNT
    waves = 2.0 * np.pi * (np.array([0.7, 1.9, 3.1, 8.0, 20.0, 50.0]) * t[:, None])
    return np.sin(waves[:, None, :] + rng.uniform(0.0, 2.0 * np.pi, (JOINTS, P)))


def solved(A: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, Likeness, list]:
    """Return least squares with its white covariance, its likeness, and residuals by block."""
    flat = A.reshape(-1, P)
    white = np.linalg.inv(flat.T @ flat)
    x = white @ flat.T @ b.ravel()
    left = list((b - A @ x).reshape(BLOCKS, -1))
    rows = list(A.reshape(BLOCKS, -1, P))
    return x, white, likeness(rows, left, white, 1.0, NODES), left


@pytest.mark.parametrize("fading", [0.9, 0.97])
def test_the_covariance_is_that_of_many_draws(fading: float) -> None:
    """NEES averages P; without likeness it is many times that."""
    rng = np.random.default_rng(1)
    A, plain, honest = regressors(rng), [], []
    for _ in range(200):
        x, white, found, _ = solved(A, noise(rng, fading))
        plain.append(x @ np.linalg.solve(white, x))
        honest.append(x @ np.linalg.solve(widened(white, found.excess), x))
    assert np.mean(plain) > 3.0 * P
    # Student's factor widens sigma, by a fifth at most
    assert 0.6 * P < np.mean(honest) < chi2.ppf(0.9999, 200 * P) / 200
    assert np.mean(np.array(honest) > chi2.ppf(0.9973, P)) < 0.03


def test_sigma_of_white_residuals_stays_within_two_percent() -> None:
    rng = np.random.default_rng(2)
    A, grown = regressors(rng), []
    for _ in range(40):
        _, white, found, left = solved(A, noise(rng, 0.0))
        trust = Trust()
        trust.learn(left, 1.0, (), lambda found=found, **_: found)
        grown.append(np.diag(trust.widened(white, BLOCKS)) / np.diag(white))
    assert np.sqrt(np.max(grown)) < 1.02


def test_the_covariance_never_shrinks() -> None:
    rng = np.random.default_rng(3)
    _, white, found, _ = solved(regressors(rng), noise(rng, -0.8))
    grown = widened(white, found.excess) - white
    assert np.linalg.eigvalsh(grown)[0] > -1e-12 * np.trace(white)


def test_noise_that_fades_is_no_contradiction() -> None:
    rng = np.random.default_rng(4)
    A = regressors(rng)
    for _ in range(100):
        _, _, found, left = solved(A, noise(rng, 0.9))
        trust = Trust()
        trust.learn(left, 1.0, (), lambda found=found, **_: found)
        assert trust.excess is not None
        assert not trust.mismatch(1.0), trust.in_words(1.0)


def test_halves_of_two_truths_contradict_each_other() -> None:
    rng = np.random.default_rng(5)
    A, b = regressors(rng), noise(rng, 0.9)
    b[COUNT // 2 :] += A[COUNT // 2 :] @ np.full(P, 2.0)
    _, _, found, left = solved(A, b)
    assert found.halves[0] > found.halves[1]
    trust = Trust()
    trust.learn(left, 1.0, (), lambda **_: found)
    assert "halves" in trust.in_words(1.0)


@pytest.mark.parametrize("half", [slice(0, BLOCKS // 2), slice(BLOCKS // 2, None)])
def test_a_channel_missing_in_one_half_is_no_contradiction(half: slice) -> None:
    """Only the other half's blocks have every channel."""
    rng = np.random.default_rng(8)
    A = regressors(rng)
    rows, left = list(A.reshape(BLOCKS, -1, P)), list(noise(rng, 0.0).reshape(BLOCKS, -1))
    for k in range(BLOCKS)[half]:
        rows[k], left[k] = rows[k][: 2 * NODES], left[k][: 2 * NODES]
    kept = np.concatenate(rows)
    white = np.linalg.inv(kept.T @ kept)
    x = white @ kept.T @ np.concatenate(left)
    left = [b - a @ x for a, b in zip(rows, left, strict=True)]
    found = likeness(rows, left, white, 1.0, NODES)
    assert np.isfinite(found.excess).all()
    assert found.halves[0] < found.halves[1]


def test_a_constant_that_no_state_explains_lasts() -> None:
    rng = np.random.default_rng(6)
    rows = rng.standard_normal((BLOCKS, 50))
    found, limit = lasting(list(rows + 0.5 * rng.standard_normal(50)))
    assert found > limit
    for _ in range(50):
        found, limit = lasting(list(rng.standard_normal((BLOCKS, 50))))
        assert found < limit
    assert lasting([]) == (0.0, 1.0)


def test_likeness_of_an_inertial_unit_is_a_mismatch() -> None:
    """Rows are three torques, then three axes; only the torques may be alike."""
    rng = np.random.default_rng(7)
    for in_torques, in_axes in ((0.9, 0.0), (0.0, 0.9)):
        rows = np.concatenate([noise(rng, in_torques), noise(rng, in_axes)], axis=1)
        blocks = list(rows.reshape(BLOCKS, -1))
        besides = besides_torques(blocks, [JOINTS] * BLOCKS, NODES)
        assert [len(one) for one in besides] == [NODES * JOINTS] * BLOCKS
        trust = Trust()
        trust.learn(blocks, 1.0, besides)
        assert trust.mismatch(1.0) == (in_axes > 0.0)
    alone = list(noise(rng, 0.9).reshape(BLOCKS, -1))
    of_free_base = Trust()
    of_free_base.learn(alone, 1.0, alone)
    assert of_free_base.mismatch(1.0)


def test_a_repeated_motion_teaches_nothing_new() -> None:
    """Friction repeats with the motion: a taper takes four periods for four independent ones."""
    rng = np.random.default_rng(8)
    once, tapered, squares = regressors(rng)[: COUNT // 4], [], []
    A = np.tile(once, (4, 1, 1))
    for _ in range(40):
        b = np.tile(noise(rng, 0.9)[: COUNT // 4], (4, 1)) + 0.05 * noise(rng, 0.0)
        x, white, independent, left = solved(A, b)
        found, limit = lasting(left)
        assert found > limit
        tapered.append(x @ np.linalg.solve(widened(white, independent.excess), x))
        rows = list(A.reshape(BLOCKS, -1, P))
        cost = likeness(rows, left, white, 1.0, NODES, repeats=True)
        squares.append(x @ np.linalg.solve(widened(white, cost.excess), x))
    assert np.mean(squares) < 0.6 * np.mean(tapered)
