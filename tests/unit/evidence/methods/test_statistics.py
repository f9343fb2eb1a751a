"""Figures of efficient, biased and failed methods on errors drawn from known distributions."""

import numpy as np
import pytest

from evidence.methods.cases import SAMPLE, Key, StudyRecord
from evidence.methods.statistics import figures
from hil.judge import chi_square

GROUPS = {"mass": slice(0, 1), "first moment": slice(1, 4), "inertia": slice(4, 10)}
SEEDS = 200


def covariance():
    rng = np.random.default_rng(3)
    scale = np.diag(10.0 ** rng.uniform(-3, 3, 10))
    A = rng.normal(size=(10, 14))
    return scale @ A @ A.T @ scale


def records(errors, nees):
    return [
        StudyRecord(
            key=Key(level=SAMPLE, case="target", sensors="data sheet", method="fused", seed=k),
            status="OK",
            error=error,
            sigma=None,
            nees=float(value),
            iterations=1,
        )
        for k, (error, value) in enumerate(zip(errors, nees, strict=True))
    ]


def drawn(scale=1.0, offset=0.0):
    C = covariance()
    rng = np.random.default_rng(11)
    errors = scale * rng.normal(size=(SEEDS, 10)) @ np.linalg.cholesky(C).T
    errors += offset * np.sqrt(np.diag(C))
    unit = np.sqrt(np.diag(C))
    correlation = C / np.outer(unit, unit)
    nees = [z @ np.linalg.solve(correlation, z) for z in errors / unit]
    return records(errors, nees), [C] * SEEDS


def test_efficient_method_is_at_one_everywhere_and_consistent():
    rows, bounds = drawn()
    f = figures(rows, bounds, bounds, GROUPS)
    # 2000 degrees of freedom: 1.6 % one sigma; mass has 200: 5 %
    assert f.overall.value == pytest.approx(1.0, abs=0.06)
    for ratio in f.groups.values():
        assert ratio.low < 1.05
        assert ratio.high > 0.95
    assert chi_square.ends(SEEDS * 10, 1e-3)[0] / SEEDS < f.nees
    assert f.nees < chi_square.ends(SEEDS * 10, 1e-3)[1] / SEEDS
    assert f.biased == {}
    assert (f.failed, f.not_ok, f.dof) == (0, 0, 10)


def test_ratio_is_homogeneous_and_independent_of_units():
    rows, bounds = drawn()
    doubled, _ = drawn(scale=2.0)
    one, two = figures(rows, bounds, bounds, GROUPS), figures(doubled, bounds, bounds, GROUPS)
    for group in GROUPS:
        assert two.groups[group].value == pytest.approx(2 * one.groups[group].value)
        assert two.groups[group].low == pytest.approx(2 * one.groups[group].low)


def test_bootstrap_interval_is_that_of_chi_square_for_gaussian_errors():
    rows, bounds = drawn()
    ratio = figures(rows, bounds, bounds, GROUPS).overall
    low, high = chi_square.ends(SEEDS * 10)
    # the bootstrap's own scatter over 200 seeds is below 10 % of its width
    width = (high / SEEDS / 10) ** 0.5 - (low / SEEDS / 10) ** 0.5
    assert ratio.high - ratio.low == pytest.approx(ratio.value * width, rel=0.3)


def test_bias_is_named_with_its_size():
    rows, bounds = drawn(offset=0.7)
    f = figures(rows, bounds, bounds, GROUPS)
    assert f.biased["mass"] == pytest.approx(0.7, abs=0.25)  # 3.5 sigma of a mean over 200


def test_few_seeds_get_the_chi_square_interval():
    rows, bounds = drawn()
    f = figures(rows[:2], bounds[:2], bounds[:2], GROUPS)
    low, high = chi_square.ends(2)
    assert f.groups["mass"].low == pytest.approx(f.groups["mass"].value * (2 / high) ** 0.5)
    assert f.groups["mass"].high == pytest.approx(f.groups["mass"].value * (2 / low) ** 0.5)


def test_failed_seed_is_counted_and_left_out():
    rows, bounds = drawn()
    key = Key(level=SAMPLE, case="target", sensors="data sheet", method="fused", seed=SEEDS)
    lost = StudyRecord(key=key, status="FAILED", error=None, sigma=None, nees=np.inf, iterations=0)
    f = figures([*rows, lost], [*bounds, bounds[0]], [*bounds, bounds[0]], GROUPS)
    same = figures(rows, bounds, bounds, GROUPS)
    assert (f.failed, f.not_ok, f.seeds) == (1, 1, SEEDS + 1)
    assert f.overall == same.overall
