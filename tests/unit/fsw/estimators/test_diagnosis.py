"""Diagnosis of an estimate against cases that can be worked out by hand, and wrong priors."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from fsw.estimators.diagnosis import (
    conflict_limit,
    correlation_of,
    diagnose,
    gains,
    prior_conflict,
    stated_conflict,
    verdict,
)
from fsw.estimators.model.inertia import report_jacobian, to_parameters
from fsw.estimators.recursive.online import OnlineEstimator, build_online
from fsw.messages import Block, Estimate
from hil.world.truth import Body
from tests.support.estimator_cases import (
    TARGET,
    make_config,
    noisy_blocks,
    parameters,
    robot_model,
)
from tests.support.estimator_cases import (
    plain as body_words,
)
from tests.support.starts import CASES, config_of

RNG = np.random.default_rng(0)
P0 = np.diag([4.0, 1.0, 9.0])
DIRECTION = np.array([1.0, 2.0, 0.0])
F = 25.0 * np.outer(DIRECTION, DIRECTION)  # the data know one combination
P = np.linalg.inv(np.linalg.inv(P0) + F)


def test_gains_are_the_datas_information_over_the_priors() -> None:
    gain, W = gains(P0, P)
    assert gain[:2] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert gain[2] == pytest.approx(DIRECTION @ P0 @ DIRECTION * 25.0)
    assert np.allclose(W @ P0 @ W.T, np.eye(3))
    assert np.allclose(W @ P @ W.T, np.diag(1.0 / (1.0 + gain)))


def test_prior_conflict_is_the_distance_of_data_from_prior() -> None:
    """One datum y = d x of variance 1/25: (y - d m)^2 / (1/25 + d P0 d)."""
    mean, y = np.array([1.0, -1.0, 2.0]), 30.0
    estimate = P @ (np.linalg.solve(P0, mean) + 25.0 * DIRECTION * y)
    distance, dof = prior_conflict(mean, P0, estimate, P)
    assert dof == 1
    expected = (y - DIRECTION @ mean) ** 2 / (1 / 25 + DIRECTION @ P0 @ DIRECTION)
    assert distance == pytest.approx(expected)
    assert conflict_limit(1) == pytest.approx(chi2.ppf(1 - 1e-4, 1))


def test_diagnosis_in_numbers() -> None:
    d = diagnose(
        names=("a", "b", "c"),
        prior_mean=np.zeros(3),
        prior_covariance=P0,
        mean=np.zeros(3),
        covariance=P,
        bodies={},
        duration_s=1.0,
        fisher=F,
    )
    assert d.known == 1
    assert [c.source for c in d.combinations] == ["prior", "prior", "data"]
    assert d.efficiency_trace == pytest.approx(1.0)
    assert d.efficiency_volume == pytest.approx(1.0)
    assert np.allclose(d.correlation, correlation_of(P))
    wasteful = diagnose(
        names=("a", "b", "c"),
        prior_mean=np.zeros(3),
        prior_covariance=P0,
        mean=np.zeros(3),
        covariance=np.linalg.inv(np.linalg.inv(P0) + F / 4),
        bodies={},
        duration_s=1.0,
        fisher=F,
    )
    assert wasteful.efficiency_volume < 0.9


def test_verdict_says_how_long_is_needed() -> None:
    """4 % after 10 s of information at a constant rate: 1 % needs sixteen times as long."""
    assert verdict("target", 100.0, 4.0, 1e6, 10.0) == (
        "target mass identified to +-4 % (1 sigma), needs 150 s more of such motion for 1 %"
    )
    assert verdict("target", 100.0, 0.5, 1e6, 10.0).endswith("within 1 %")
    assert "not identified" in verdict("target", 100.0, 49.9, 50.0, 10.0)
    assert "not identified" in verdict("target", 100.0, 50.0, 50.0, 0.0)


def run(blocks: list[Block], **options: Any) -> tuple[OnlineEstimator, list[Estimate], list[str]]:
    config = make_config(("target",), **options)
    online = build_online(config, robot_model())
    estimates = [online.push(block) for block in blocks]
    estimates.append(online.finish())
    return online, estimates, [code for _, code, _ in online.events()]


def test_report_is_json_and_agrees_with_the_estimate() -> None:
    online, estimates, _ = run(noisy_blocks("target", 1, 40.0))
    report = json.loads(json.dumps(online.report()))
    assert report["valid"]
    assert report["verdict"]["target"].startswith("target mass identified to")
    assert report["crb_sigma"] == pytest.approx(np.sqrt(np.diag(estimates[-1].covariance)))
    assert report["efficiency_volume"] == pytest.approx(1.0)
    assert report["known_combinations"] >= 10
    assert abs(report["innovation_lag1"]["correlation"]) < report["innovation_lag1"]["bound"]
    assert report["prior_conflict"]["distance"] < report["prior_conflict"]["limit"]


def test_a_prior_within_its_own_sigmas_is_no_conflict_in_any_product_of_them() -> None:
    """Mass and centre of mass 0.9 sigma low: 30 sigma^2 of ten in the moments, 3.2 as stated."""
    mean = parameters(TARGET)
    report = np.concatenate([[TARGET.mass_kg], TARGET.com_m, TARGET.inertia_kg_m2])
    sigma = 0.5 * np.abs(report) + 1e-3
    low = report.copy()
    low[:4] -= 0.9 * sigma[:4]
    prior = to_parameters(low[0], low[1:4], low[4:])
    root = np.linalg.solve(report_jacobian(prior), np.diag(sigma))
    P0, P = root @ root.T, 1e-12 * np.eye(10)
    assert prior_conflict(prior, P0, mean, P)[0] > 25.0
    distance, dof = stated_conflict(prior, P0, mean, P, 1)
    assert dof == 10
    assert distance == pytest.approx(4 * 0.9**2, rel=1e-3)


@pytest.mark.parametrize("method", ["fused", "mrnea"])
@pytest.mark.parametrize("case", ["base", "target", "both"])
def test_priors_half_off_raise_no_conflict_in_a_short_run(case: str, method: str) -> None:
    """11 s from 30-50 % wrong starts whose sigma says so; two seeds."""
    for seed in (1, 3):
        online = build_online(config_of(case, seed, method=method), robot_model())
        for block in noisy_blocks(CASES[case][0], seed, 11.0):
            online.push(block)
        online.finish()
        assert "PRIOR_CONFLICT" not in [code for _, code, _ in online.events()]


def nees(estimate: Estimate) -> float:
    error = estimate.mean[:10] - parameters(TARGET)
    return float(error @ np.linalg.solve(estimate.covariance[:10, :10], error))


NEES_LIMIT = chi2.ppf(1 - 1e-6, 10)


def scaled(factor: float) -> Body:
    inertia = tuple(np.array(TARGET.inertia_kg_m2) * factor)
    return Body(TARGET.mass_kg * factor, TARGET.com_m, inertia)


@pytest.mark.parametrize("factor", [0.1, 10.0])
@pytest.mark.parametrize("method", ["fused", "mrnea"])
def test_a_mean_ten_times_off_with_a_sigma_to_match_is_overcome(method: str, factor: float) -> None:
    """The sigma is the error's size: 0.9 or 9 times the truth. NEES within 1 - 1e-6 at the end."""
    config = make_config(("target",), target=scaled(factor), method=method)
    data = config.model_dump()
    body = body_words(scaled(factor))
    true = body_words(TARGET, abs(factor - 1.0))
    data["bodies"]["target"] = body | {"sigma": true["sigma"]}
    online = build_online(type(config).model_validate(data), robot_model())
    for block in noisy_blocks("target", 2):
        online.push(block)
    final = online.finish()
    assert final.valid, final.reason
    assert nees(final) < NEES_LIMIT


@pytest.mark.parametrize("method", ["fused", "mrnea"])
def test_a_sigma_ten_times_too_small_is_told_and_widened(method: str) -> None:
    """A mean 40 % off and a sigma of 4 %: PRIOR_CONFLICT, then an honest estimate."""
    wrong = scaled(1.4)
    config = make_config(("target",), target=wrong, method=method)
    data = config.model_dump()
    data["bodies"]["target"] = body_words(wrong, 0.04)
    data["bodies"]["target"]["sigma"]["com_m"] = [0.02, 0.02, 0.02]
    data["bodies"]["target"]["sigma"]["inertia_kg_m2"] = [10.0, 1.0, 1.0, 10.0, 1.0, 10.0]
    online = build_online(type(config).model_validate(data), robot_model())
    for block in noisy_blocks("target", 3):
        online.push(block)
    final = online.finish()
    assert "PRIOR_CONFLICT" in [code for _, code, _ in online.events()]
    assert nees(final) < NEES_LIMIT


@pytest.mark.parametrize("method", ["fused", "mrnea", "rda", "cm"])
def test_stale_and_repeated_blocks_change_nothing(method: str) -> None:
    blocks = noisy_blocks("target", 4, 12.0)
    _, clean, _ = run(blocks, method=method)
    _, repeated, _ = run(
        [b for pair in zip(blocks, blocks, strict=True) for b in pair], method=method
    )
    _, stale, _ = run([*blocks, *blocks[:10]], method=method)
    assert np.array_equal(clean[-1].mean, repeated[-1].mean)
    assert repeated[-1].extra["ignored"] == len(blocks)
    assert stale[-1].extra["ignored"] == 10
    assert stale[-1].blocks == clean[-1].blocks


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300, 1e12])
@pytest.mark.parametrize("name", ["tau_nm", "qd_rad_s", "f_NS_B_m_s2"])
@pytest.mark.parametrize(
    ("method", "weighting"), [("fused", "eiv"), ("mrnea", "eiv"), ("mrnea", "bc")]
)
def test_absurd_blocks_never_crash_and_never_stay(
    method: str, weighting: str, name: str, value: float
) -> None:
    """From the first block on, before anything has settled; the result must be as without."""
    blocks = noisy_blocks("target", 5, 10.0)
    bad = []
    for k, block in enumerate(blocks):
        values = getattr(block, name).copy()
        if k in (0, 3, 12):
            values[0, 0] = value
        bad.append(replace(block, **{name: values}))
    good = [b for k, b in enumerate(blocks) if k not in (0, 3, 12)]
    _, got, _ = run(bad, method=method, weighting=weighting)
    _, expected, _ = run(good, method=method, weighting=weighting)
    assert got[-1].gated == 3
    assert np.all(np.isfinite(got[-1].covariance))
    step = got[-1].mean - expected[-1].mean
    assert step @ np.linalg.solve(expected[-1].covariance, step) < 1e-2 * len(step)


def test_a_body_without_inertia_at_an_iterate_is_survived() -> None:
    """Rows that fail at bad iterates leave the estimate not converged, then it recovers."""
    online = build_online(make_config(("target",)), robot_model())
    rows, failing = online.rows, [True]

    def fragile(block: Block, x: np.ndarray, before: Any) -> Any:
        if failing[0] and block.index == 2 and len(online.recursion.memory) > 5:
            raise np.linalg.LinAlgError("base inertia is not positive definite")
        return rows(block, x, before)

    online.rows = fragile
    online.reset()
    blocks = noisy_blocks("target", 6, 20.0)
    for block in blocks[:20]:
        estimate = online.push(block)
    assert estimate.reason == "NOT_CONVERGED"
    failing[0] = False
    for block in blocks[20:]:
        estimate = online.push(block)
    assert estimate.valid
