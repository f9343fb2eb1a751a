"""Changes that no state has: their size, what they do to an estimate, how rarely chance shows."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from fsw.estimators.noise.creep import NOTICED, ONSETS, Creep, Scores, changes, worst_change
from fsw.messages.false_alarms import CHANGES, rate

BLOCKS, ROWS, STATES = 60, 12, 4
NAMES = ("a", "b", "c", "d", "gain", "zero")


def problem() -> Any:
    """Return what a problem of four states, of which two are a body's, says of itself."""
    watched = SimpleNamespace(names=NAMES)
    return cast(Any, SimpleNamespace(names=NAMES[:STATES], bodies=slice(0, 2), watched=watched))


def columns(rng: np.random.Generator) -> np.ndarray:
    """Return whitened columns (blocks, rows, all names) that are unlike one another."""
    return rng.standard_normal((BLOCKS, ROWS, len(NAMES)))


def fitted(G: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return least squares of all rows: estimate and covariance."""
    A = G[:, :, :STATES].reshape(-1, STATES)
    P = np.linalg.solve(A.T @ A, np.eye(STATES))
    return P @ A.T @ y.ravel(), P


def judged(G: np.ndarray, y: np.ndarray) -> list[Creep]:
    """Return the changes that the residuals of a fit show."""
    x, P = fitted(G, y)
    scores = [Scores.of(g[:, :STATES], c, g) for g, c in zip(G, y, strict=True)]
    return list(changes(problem(), scores, len(scores), x, P, 1.0))


def shown(found: list[Creep], onset: float | None) -> Creep:
    """Return the clearest change, which has this onset."""
    clearest = max(found, key=lambda one: one.sigmas)
    assert clearest.onset == onset
    return clearest


@pytest.mark.parametrize("k", [4, 5])
@pytest.mark.parametrize("onset", ONSETS)
def test_a_ramp_is_named_and_what_it_does_to_the_estimate_is_found(k: int, onset: float) -> None:
    """Without noise, the movement is the difference between two fits."""
    G, truth = columns(np.random.default_rng(3)), np.arange(1.0, STATES + 1.0)
    clean = G[:, :, :STATES] @ truth
    ramp = np.maximum(np.arange(BLOCKS) / BLOCKS - onset, 0.0)
    lying = clean + 40.0 * ramp[:, None] * G[:, :, k]
    found = shown(judged(G, lying), onset)
    assert found.name == NAMES[k]
    moved = fitted(G, lying)[0] - fitted(G, clean)[0]
    assert found.moved == pytest.approx(moved, rel=1e-9)


def test_a_constant_that_is_declared_zero_is_named() -> None:
    G = columns(np.random.default_rng(4))
    lying = G[:, :, :STATES] @ np.ones(STATES) + 2.0 * G[:, :, 4]
    found = shown(judged(G, lying), None)
    assert found.name == "gain"
    assert found.moved == pytest.approx(fitted(G, lying)[0] - np.ones(STATES), rel=1e-9)


def test_a_state_that_drifts_is_named() -> None:
    G = columns(np.random.default_rng(5))
    course = np.maximum(np.arange(BLOCKS) / BLOCKS - 0.4, 0.0)
    found = judged(G, G[:, :, :STATES] @ np.ones(STATES) + 20.0 * course[:, None] * G[:, :, 1])
    assert shown(found, 0.4).name == "b"


def test_chance_is_noticed_no_more_often_than_stated() -> None:
    """Of one look at 6 quantities in 5 to 6 courses, 32 tests are the whole of a union bound."""
    rng, count, tests = np.random.default_rng(6), 3000, 32
    G = columns(rng)
    found = sum(bool(judged(G, rng.standard_normal((BLOCKS, ROWS)))) for _ in range(count))
    expected = rate("creep") / CHANGES * tests * count
    assert found <= expected + 4.0 * np.sqrt(expected)


def test_sigma_follows_a_change_and_not_chance() -> None:
    """At the threshold it does not change; far above, it is the whole movement."""
    G = columns(np.random.default_rng(7))
    ramp = (np.arange(BLOCKS) / BLOCKS)[:, None]
    found = shown(judged(G, 100.0 * ramp * G[:, :, 4]), 0.0)
    assert found.sigmas > 10.0 * NOTICED
    assert np.diag(found.excess) == pytest.approx(found.moved**2, rel=0.01)


def test_few_blocks_show_nothing() -> None:
    G = columns(np.random.default_rng(8))[:4]
    scores = [Scores.of(g[:, :STATES], 100.0 * g[:, 4], g) for g in G]
    assert (
        worst_change(changes(problem(), scores, len(scores), np.zeros(STATES), np.eye(STATES), 1.0))
        is None
    )


def test_the_worst_change_moves_a_body_most_beyond_what_noise_explains() -> None:
    def change(name: str, sigmas: float, harm: float) -> Creep:
        return Creep(name=name, onset=0.0, sigmas=sigmas, moved=np.zeros(1), harm=harm)

    noise, clear = change("noise", 1.001 * NOTICED, 8.0), change("clear", 3.0 * NOTICED, 3.0)
    assert worst_change([noise, clear, change("harmless", 9.0 * NOTICED, 0.1)]) is clear
    assert worst_change([]) is None


def test_a_change_is_named_in_words_with_its_key() -> None:
    moved = np.zeros(STATES)
    change = Creep(name="joint_zero.joint7", onset=0.2, sigmas=16.2, moved=moved, harm=30.3)
    assert change.words().startswith("joint zeros (joint7) changes within the run (16.2")
    assert change.words().endswith("state its doubt by joints[].zero_sigma_rad")
