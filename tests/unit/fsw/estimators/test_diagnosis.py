"""Diagnosis of an estimate against cases that can be worked out by hand, and wrong priors."""

import json
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
from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.measurement.mrnea import Rows
from fsw.estimators.measurement.row_functions import RowsFunction
from fsw.estimators.model.inertia import report_jacobian, to_parameters
from fsw.estimators.recursive.online import build_online
from tests.support.estimator_cases import (
    TARGET,
    make_config,
    noisy_blocks,
    parameters,
    robot_model,
)
from tests.support.recursions import to_the_end

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
        bound=np.linalg.inv(np.linalg.inv(P0) + F),
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
        bound=np.linalg.inv(np.linalg.inv(P0) + F),
    )
    assert wasteful.efficiency_volume < 0.9


def test_verdict_says_how_long_is_needed() -> None:
    """4 % after 10 s of information at a constant rate: 1 % needs sixteen times as long."""
    assert verdict("target", 100.0, 4.0, 1e6, 10.0) == (
        "target mass identified to +-4 % (1 sigma), needs 150 s more of such motion for 1 %"
    )
    assert verdict("target", 100.0, 0.5, 1e6, 10.0).endswith("the goal of 1 % is reached")
    assert "not identified" in verdict("target", 100.0, 49.9, 50.0, 10.0)
    assert "not identified" in verdict("target", 100.0, 50.0, 50.0, 0.0)


def test_report_is_json_and_agrees_with_the_estimate() -> None:
    online, estimates, _ = to_the_end(noisy_blocks("target", 1, 40.0))
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


def test_a_body_without_inertia_at_an_iterate_is_survived() -> None:
    """Rows that fail at bad iterates leave the estimate not converged, then it recovers."""
    online = build_online(make_config(("target",)), robot_model())
    rows, failing = online.rows, [True]

    class Fragile(RowsFunction):
        def stacked(self, s: BlockStack, x: np.ndarray, before: Any = None) -> list[Rows]:
            has_third = any(block.index == 2 for block in s.blocks)
            if failing[0] and has_third and len(online.recursion.memory) > 5:
                raise np.linalg.LinAlgError("base inertia is not positive definite")
            return rows.stacked(s, x, before)

    online.rows = Fragile()
    online.reset()
    blocks = noisy_blocks("target", 6, 20.0)
    for block in blocks[:20]:
        estimate = online.push(block)
    assert estimate.reason == "NOT_CONVERGED"
    failing[0] = False
    for block in blocks[20:]:
        estimate = online.push(block)
    assert estimate.valid
