"""Which windows are held out."""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.polynomial import legendre
from scipy.signal import lfilter

from fsw.errors import ConfigError
from fsw.estimators.conditioning.polynomial import EXTRA_DEGREE, gauss_nodes
from fsw.estimators.noise.found import mean_products
from fsw.messages import Block
from offline.holdout import _verdict, judge, split, to_text
from tests.support.estimator_cases import NODES, TARGET, N, make_problem, true_blocks_cached


def blocks(count: int) -> Any:
    return [SimpleNamespace(index=k) for k in range(count)]


@pytest.mark.parametrize(("share", "count", "held"), [(0.3, 10, 3), (0.5, 9, 4), (0.9, 10, 9)])
def test_the_share_is_held_out_and_spread_evenly(share, count, held):
    used, out = split(blocks(count), share)
    assert len(out) == held
    assert sorted(block.index for block in (*used, *out)) == list(range(count))
    gaps = [b.index - a.index for a, b in itertools.pairwise(out)]
    assert max(gaps) - min(gaps) <= 1


@pytest.mark.parametrize(("share", "count"), [(0.0, 9), (-1.0, 9), (0.95, 9), (0.3, 2), (0.5, 1)])
def test_a_share_that_cannot_be_is_one_line(share, count):
    with pytest.raises(ConfigError, match="--holdout"):
        split(blocks(count), share)


def test_no_number_is_no_share():
    with pytest.raises(ConfigError, match="--holdout"):
        split(blocks(9), float("nan"))


@pytest.mark.parametrize("shared", [0.0, 0.3, 0.9])
def test_a_right_model_is_passed_with_an_error_that_all_nodes_share(shared):
    rng = np.random.default_rng(7)
    count, failed = 1000, 0
    for _ in range(400):
        own = rng.standard_normal(count) * np.sqrt(1.0 - shared)
        ratio = own + rng.standard_normal() * np.sqrt(shared)
        failed += not _verdict(ratio, ratio, shared, "N m")["passed"]
    assert failed <= 1  # 4 sigma of the mean: 0.025 expected


@pytest.mark.parametrize(("shared", "wrong"), [(0.0, 3.0), (0.3, 5.0)])
def test_residuals_of_a_wrong_model_are_failed(shared, wrong):
    ratio = wrong * np.random.default_rng(8).standard_normal(1000)
    assert not _verdict(ratio, ratio, shared, "N m")["passed"]


def with_coloured_torque(made: Sequence[Block], sigma_nm: float) -> list[Block]:
    """Return the blocks with a torque that fades in 20 samples, as the conditioner shows it."""
    rng, size = np.random.default_rng(9), 200
    fading, t = np.exp(-1.0 / 20.0), (np.arange(size) + 0.5) * (2.0 / size) - 1.0
    fresh = np.sqrt(1.0 - fading**2) * rng.standard_normal((size * len(made) + 500, N))
    noise = sigma_nm * lfilter([1.0], [1.0, -fading], fresh, axis=0)[500:]
    found = []
    for block, own in zip(made, noise.reshape(len(made), size, N), strict=True):
        high = legendre.legvander(t, NODES - 1 + EXTRA_DEGREE)
        left = own - high @ np.linalg.lstsq(high, own, rcond=None)[0]
        at_nodes = legendre.legval(gauss_nodes(NODES), legendre.legfit(t, own, NODES - 1)).T
        products = mean_products(left)
        found.append(replace(block, tau_nm=block.tau_nm + at_nodes, tau_products_nm2=products))
    return found


def test_noise_that_an_estimate_finds_is_in_the_sigma_of_a_held_out_window() -> None:
    """Ten times the declared noise, none of it white: the estimate counts it, so must its judge."""
    made = with_coloured_torque(true_blocks_cached("target", 24.0), 0.5)
    problem = make_problem(target=TARGET)
    state = problem, problem.prior_mean, 1e-8 * problem.prior_covariance
    unfound = [replace(block, tau_products_nm2=np.zeros((0, N))) for block in made]
    declared = judge(unfound, unfound[1::3], *state)["channels"]
    torques = [name for name in declared if name.startswith("torque")]
    assert not any(declared[name]["passed"] for name in torques), declared
    found = judge(made, made[1::3], *state)["channels"]
    assert all(found[name]["passed"] for name in torques), found
    assert 0.7 < np.median([found[name]["rms_over_sigma"] for name in torques]) < 1.3


def test_a_verdict_that_the_channels_do_not_explain_names_its_cause() -> None:
    channel = _verdict(np.zeros(9), np.zeros(9), 0.0, "N m")
    held = {"passed": False, "windows": 3, "channels": {"torque.a": channel}, "prior_only": []}
    assert "contradict the configuration" in to_text(held)[0]
    assert "contradict" not in to_text(held | {"passed": True})[0]
    failed = {"torque.a": channel | {"passed": False}}
    assert "contradict" not in to_text(held | {"channels": failed})[0]
