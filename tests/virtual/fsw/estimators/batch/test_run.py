"""Batch identification of blocks that hold junk, rest, noise above the declared, or a change."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from fsw.config import Config
from fsw.errors import EstimatorError
from fsw.estimators.batch.run import run_batch
from fsw.messages import Block
from tests.support.estimator_cases import (
    TARGET,
    at_rest,
    draw_biases,
    noisy,
    noisy_blocks,
    true_block,
    true_blocks_cached,
)
from tests.support.estimator_cases import motion as true_motion
from tests.support.starts import CASES, STEP_AT, config_of, misjudged, stepped, truth_of

ALL = ["base", "target", "both"]
SURE = 1 - 1e-6


def batch(config: Config, blocks: Sequence[Block], method: str = "fused") -> dict[str, Any]:
    return run_batch(config, blocks, method, ())


def nees(case: str, result: dict[str, Any]) -> float:
    truth = truth_of(case)
    k = slice(0, len(truth))
    error = np.array(result["mean"])[k] - truth
    return float(error @ np.linalg.solve(np.array(result["covariance"])[k, k], error))


@pytest.mark.parametrize("method", ["fused", "rda", "mrnea"])
@pytest.mark.parametrize("case", ALL)
def test_junk_and_repeated_blocks_are_left_out_and_counted(case: str, method: str) -> None:
    """Not finite, absurd, twice; and one window of a torque 5 N m off, which is finite."""
    config, blocks = config_of(case, 3, method=method), noisy_blocks(CASES[case][0], 3, 24.0)
    bad = {7: ("tau_nm", np.nan), 20: ("w_NB_B_rad_s", 1e300), 31: ("qd_rad_s", np.inf)}
    spoilt = list(blocks)
    for k, (name, value) in bad.items():
        values = getattr(blocks[k], name).copy()
        values[0, 0] = value
        spoilt[k] = replace(blocks[k], **{name: values})
    spoilt[40] = replace(blocks[40], tau_nm=blocks[40].tau_nm + 5.0)
    spoilt += blocks[50:53]
    good = [block for k, block in enumerate(blocks) if k not in (*bad, 40)]
    got, expected = batch(config, spoilt, method), batch(config, good, method)
    assert got["gated"] == len(bad) + 1 + 3
    assert expected["gated"] == 0
    assert got["status"] == expected["status"]
    step = np.array(got["mean"]) - np.array(expected["mean"])
    P = np.array(expected["covariance"])
    assert step @ np.linalg.solve(P, step) < 1e-2 * len(step)
    np.testing.assert_allclose(np.diag(got["covariance"]), np.diag(P), rtol=1e-2)


def test_nothing_but_junk_is_refused() -> None:
    blocks = noisy_blocks("target", 3, 2.0)
    bad = [replace(block, tau_nm=block.tau_nm * np.nan) for block in blocks]
    with pytest.raises(EstimatorError, match="no usable block"):
        batch(config_of("target", 3), bad)


@pytest.mark.parametrize("method", ["fused", "rda", "mrnea", "cm", "ce"])
@pytest.mark.parametrize("case", ALL)
def test_rest_is_insufficient_and_leaves_the_prior(case: str, method: str) -> None:
    config = config_of(case, 1, method=method if method != "ce" else "fused")
    rng = np.random.default_rng(0)
    biases = draw_biases(rng)
    still = true_block(true_motion(CASES[case][0]), -2.0)
    blocks = [at_rest(noisy(replace(still, index=k), rng, biases)) for k in range(30)]
    result = batch(config, blocks, method)
    assert result["status"] == "INSUFFICIENT_EXCITATION"
    P = np.array(result["covariance"])
    assert np.all(np.isfinite(P))
    assert np.linalg.eigvalsh(P / np.sqrt(np.outer(np.diag(P), np.diag(P))))[0] > 0
    for name in CASES[case][1]:
        prior = config.bodies[name].sigma
        assert prior is not None
        assert result["sigma"][name]["mass_kg"] > 0.5 * prior.mass_kg


@pytest.mark.parametrize("factor", [0.1, 10.0])
@pytest.mark.parametrize("method", ["fused", "rda", "mrnea"])
@pytest.mark.parametrize("case", ALL)
def test_means_ten_times_off_end_honest_or_are_told(case: str, method: str, factor: float) -> None:
    config = misjudged(case, factor, abs(factor - 1.0), method=method)
    result = batch(config, noisy_blocks(CASES[case][0], 2), method)
    assert np.all(np.isfinite(result["covariance"]))
    assert result["status"] == "OK"
    assert nees(case, result) < chi2.ppf(SURE, len(truth_of(case)))


@pytest.mark.parametrize("case", ALL)
def test_noise_twice_the_declared_doubles_the_sigmas(case: str) -> None:
    names = ("cov_joint", "cov_tau", "cov_gyro", "cov_acc")
    rng = np.random.default_rng(6)
    biases, louder = draw_biases(rng), []
    for k, clean in enumerate(true_blocks_cached(CASES[case][0], 59.9)):
        double = replace(clean, index=k, **{name: 4.0 * getattr(clean, name) for name in names})
        declared = {name: getattr(clean, name) for name in names}
        louder.append(replace(noisy(double, rng, biases), **declared))
    config = config_of(case, 6)
    loud, plain = batch(config, louder), batch(config, noisy_blocks(CASES[case][0], 6))
    assert loud["diagnosis"]["noise_ratio"] == pytest.approx(2.0, abs=0.2)
    assert nees(case, loud) < chi2.ppf(SURE, len(truth_of(case)))
    for name in CASES[case][1]:
        ratio = loud["sigma"][name]["mass_kg"] / plain["sigma"][name]["mass_kg"]
        assert ratio == pytest.approx(2.0, rel=0.25)


@pytest.mark.parametrize(
    ("case", "base_ratio", "target_ratio"),
    [("base", 0.7, 1.0), ("target", 1.0, 1.1), ("both", 0.7, 1.0), ("both", 1.0, 1.1)],
)
def test_a_window_with_a_change_in_it_is_not_ok(
    case: str, base_ratio: float, target_ratio: float
) -> None:
    rng = np.random.default_rng(4)
    biases = draw_biases(rng)
    clean = stepped(CASES[case][0], base_ratio, target_ratio)[STEP_AT - 60 : STEP_AT + 60]
    result = batch(config_of(case, 4), [noisy(block, rng, biases) for block in clean])
    assert result["status"] == "MODEL_MISMATCH"


@pytest.mark.parametrize("weighting", ["ols", "wls"])
@pytest.mark.parametrize("case", ALL)
def test_a_biased_regression_says_so_and_its_sigma_holds_the_truth(
    case: str, weighting: str
) -> None:
    config = config_of(case, 2, method="mrnea", weighting=weighting)
    blocks = noisy_blocks(CASES[case][0], 2)
    result = batch(config, blocks, "mrnea")
    assert result["biased"]
    assert "includes" in result["note"]
    assert nees(case, result) < chi2.ppf(SURE, len(truth_of(case)))
    if (case, weighting) == ("target", "ols"):
        off_kg = abs(result["mean"][0] - TARGET.mass_kg)
        assert off_kg > 0.05 * TARGET.mass_kg
        assert result["sigma"]["target"]["mass_kg"] > 0.5 * off_kg
