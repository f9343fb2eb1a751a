"""Diagnosis over whole motions: wrong priors are reported, bad blocks leave nothing behind."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.stats import chi2

from fsw.estimators.recursive.online import build_online
from fsw.messages import Estimate
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
from tests.support.recursions import to_the_end
from tests.support.starts import CASES, config_of


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
    _, clean, _ = to_the_end(blocks, method=method)
    repeated = [b for pair in zip(blocks, blocks, strict=True) for b in pair]
    _, again, _ = to_the_end([*repeated, *blocks[:10]], method=method)
    assert np.array_equal(clean[-1].mean, again[-1].mean)
    assert again[-1].extra["ignored"] == len(blocks) + 10
    assert again[-1].blocks == clean[-1].blocks


@lru_cache(maxsize=3)
def without(method: str, weighting: str, bad: tuple[int, ...]) -> Estimate:
    """Return the settled estimate of the blocks that are not bad."""
    good = [b for k, b in enumerate(noisy_blocks("target", 5, 10.0)) if k not in bad]
    return to_the_end(good, method=method, weighting=weighting)[1][-1]


@pytest.mark.parametrize("first", range(4))
@pytest.mark.parametrize(("method", "weighting"), [("fused", "eiv"), ("mrnea", "eiv")])
def test_absurd_blocks_never_crash_and_never_stay(method: str, weighting: str, first: int) -> None:
    """From the first block on, before anything has settled; the result must be as without.

    Each channel has each value in one of the four runs.
    """
    values = (np.nan, np.inf, 1e300, 1e12)
    names = {0: "tau_nm", 3: "qd_rad_s", 12: "f_NS_B_m_s2"}
    blocks = noisy_blocks("target", 5, 10.0)
    for turn, (k, name) in enumerate(names.items(), start=first):
        spoilt = getattr(blocks[k], name).copy()
        spoilt[0, 0] = values[turn % len(values)]
        blocks[k] = replace(blocks[k], **{name: spoilt})
    _, got, _ = to_the_end(blocks, method=method, weighting=weighting)
    expected = without(method, weighting, tuple(names))
    assert got[-1].gated == 3
    assert np.all(np.isfinite(got[-1].covariance))
    step = got[-1].mean - expected.mean
    assert step @ np.linalg.solve(expected.covariance, step) < 1e-2 * len(step)
