"""Absurd, stale and repeated blocks, rest and wrong priors, base and both bodies unknown.

The same for the target stands in test_diagnosis and in recursive/test_online.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from fsw.estimators.recursive.online import build_online
from fsw.messages import Block, Estimate
from tests.support.estimator_cases import (
    WINDOW_S,
    at_rest,
    draw_biases,
    noisy,
    noisy_blocks,
    robot_model,
    true_block,
)
from tests.support.estimator_cases import motion as true_motion
from tests.support.starts import CASES, config_of, misjudged, truth_of

METHODS = [("fused", "eiv"), ("rda", "eiv"), ("mrnea", "eiv")]


def pushed(
    case: str, seed: int, blocks: Sequence[Block], *, finish: bool = True, **options: Any
) -> Estimate:
    """Return the estimate after the blocks and the work due after them, or settled."""
    online = build_online(config_of(case, seed, **options), robot_model())
    for block in blocks:
        online.push(block)
    while online.work():
        pass
    return online.finish() if finish else online.estimate(0)


def nees(case: str, estimate: Estimate) -> float:
    truth = truth_of(case)
    error, P = estimate.mean[: len(truth)] - truth, estimate.covariance
    return float(error @ np.linalg.solve(P[: len(truth), : len(truth)], error))


ABSURD = {0: "tau_nm", 3: "qd_rad_s", 12: "w_NB_B_rad_s"}  # spoilt block, spoilt channel


@lru_cache(maxsize=len(METHODS) * 2)
def without_absurd(case: str, method: str, weighting: str) -> Estimate:
    """Return the settled estimate of the blocks that are left when the absurd ones are gated."""
    blocks = noisy_blocks(CASES[case][0], 5, 10.0)
    good = [block for k, block in enumerate(blocks) if k not in ABSURD]
    return pushed(case, 5, good, method=method, weighting=weighting)


@pytest.mark.parametrize("values", [(np.nan, 1e300, np.nan), (1e300, np.nan, 1e300)])
@pytest.mark.parametrize(("method", "weighting"), METHODS)
@pytest.mark.parametrize("case", ["base", "both"])
def test_absurd_blocks_are_gated_and_leave_nothing_behind(
    case: str, method: str, weighting: str, values: tuple[float, ...]
) -> None:
    """From the first block on; the result is that without them, to a tenth of a sigma rms."""
    blocks = noisy_blocks(CASES[case][0], 5, 10.0)
    for (k, name), value in zip(ABSURD.items(), values, strict=True):
        spoilt = getattr(blocks[k], name).copy()
        spoilt[0, 0] = value
        blocks[k] = replace(blocks[k], **{name: spoilt})
    got = pushed(case, 5, blocks, method=method, weighting=weighting)
    expected = without_absurd(case, method, weighting)
    assert got.gated == len(ABSURD)
    assert np.all(np.isfinite(got.covariance))
    step = got.mean - expected.mean
    assert step @ np.linalg.solve(expected.covariance, step) < 1e-2 * len(step)


@pytest.mark.parametrize("method", ["fused", "rda", "mrnea", "cm"])
@pytest.mark.parametrize("case", ["base", "both"])
def test_stale_and_repeated_blocks_change_no_bit(case: str, method: str) -> None:
    blocks = noisy_blocks(CASES[case][0], 4, 8.0)
    clean = pushed(case, 4, blocks, finish=False, method=method)
    repeated = [block for pair in zip(blocks, blocks, strict=True) for block in pair]
    again = [*repeated, *blocks[:7]]
    got = pushed(case, 4, again, finish=False, method=method)
    assert np.array_equal(got.mean, clean.mean)
    assert np.array_equal(got.covariance, clean.covariance)
    assert got.extra["ignored"] == len(blocks) + 7


@pytest.mark.parametrize(("method", "weighting"), METHODS)
@pytest.mark.parametrize("case", ["base", "both"])
def test_an_arm_at_rest_is_not_valid_and_knows_no_mass(
    case: str, method: str, weighting: str
) -> None:
    """40 windows of rest: every mass keeps more than half of its prior's sigma.

    A joint at rest is taken at rest by the conditioning, whatever its encoder's noise.
    """
    config = config_of(case, 1, method=method, weighting=weighting)
    rng = np.random.default_rng(0)
    biases = draw_biases(rng)
    still = true_block(true_motion(CASES[case][0]), -2.0)
    online = build_online(config, robot_model())
    for k in range(40):
        later = replace(still, index=k, t_ns=still.t_ns + k * round(WINDOW_S * 1e9))
        estimate = online.push(at_rest(noisy(later, rng, biases)))
        assert not estimate.valid
    final = online.finish()
    assert not final.valid
    assert np.all(np.isfinite(final.covariance))
    for name in CASES[case][1]:
        prior = config.bodies[name].sigma
        assert prior is not None
        assert final.bodies[name].mass_sigma_kg > 0.5 * prior.mass_kg


@pytest.mark.parametrize("factor", [0.1, 10.0])
@pytest.mark.parametrize("method", ["fused", "mrnea"])
@pytest.mark.parametrize("case", ["base", "both"])
def test_means_ten_times_off_end_honest(case: str, method: str, factor: float) -> None:
    """The sigma is the error's size. Whatever is published as valid holds the truth."""
    config = misjudged(case, factor, abs(factor - 1.0), method=method)
    online = build_online(config, robot_model())
    for block in noisy_blocks(CASES[case][0], 2):
        estimate = online.push(block)
        assert np.all(np.isfinite(estimate.covariance))
    final = online.finish()
    if (case, method, factor) == ("base", "mrnea", 10.0) and not final.valid:
        # whether the recursion settles from there is decided by the last digits of its rows
        assert final.reason == "NOT_CONVERGED"
        return
    assert final.valid, final.reason
    assert nees(case, final) < chi2.ppf(1 - 1e-6, len(truth_of(case)))


@pytest.mark.parametrize("method", ["fused", "mrnea"])
@pytest.mark.parametrize("case", ["base", "both"])
def test_sigmas_ten_times_too_small_are_told_and_widened(case: str, method: str) -> None:
    """Masses and inertias 40 % off, sigmas of 4 %."""
    online = build_online(misjudged(case, 1.4, 0.04, method=method), robot_model())
    for block in noisy_blocks(CASES[case][0], 3):
        online.push(block)
    final = online.finish()
    assert "PRIOR_CONFLICT" in [code for _, code, _ in online.events()]
    assert nees(case, final) < chi2.ppf(1 - 1e-6, len(truth_of(case)))
