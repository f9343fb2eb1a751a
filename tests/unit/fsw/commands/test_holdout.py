"""Which windows are held out."""

import itertools
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fsw.commands.holdout import _verdict, split
from fsw.messages.errors import ConfigError


def blocks(count: int) -> Any:
    return [SimpleNamespace(index=k) for k in range(count)]


@pytest.mark.parametrize(("share", "count", "held"), [(0.3, 10, 3), (0.5, 9, 4), (0.9, 10, 9)])
def test_the_share_is_held_out_and_spread_evenly(share, count, held):
    used, out = split(blocks(count), share)
    assert len(out) == held
    assert sorted(block.index for block in used + out) == list(range(count))
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
