"""The methods' rows: a measurement that is missing has no part in them."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.estimators.measurement.row_functions import row_function
from fsw.estimators.recursive.bias_compensated import BiasCompensatedEstimator
from tests.support.estimator_cases import N, make_config, make_problem, random_block


@pytest.mark.parametrize("method", ["mrnea", "rda", "cm", "ce", "fused"])
def test_no_method_uses_a_torque_that_is_missing(method: str) -> None:
    problem = make_problem(("base", "target"))
    x = problem.prior_mean
    absent = replace(random_block(), has_joint=np.arange(N) != 4)
    tau = absent.tau_nm.copy()
    tau[:, 4] = 1e6
    rows = row_function(method, "eiv", problem)
    a, b = rows(absent, x), rows(replace(absent, tau_nm=tau), x)
    assert np.array_equal(a.A, b.A)
    assert np.array_equal(a.b, b.b)


def test_the_compensated_regression_uses_whole_blocks_only() -> None:
    config = make_config(("target",))
    whole = random_block()
    recursion = BiasCompensatedEstimator(make_problem(("target",)), config.estimator)
    recursion.push(whole)
    before = recursion.snapshot()["sums"]
    tau = whole.tau_nm + 1e3
    recursion.push(replace(whole, index=2, tau_nm=tau, has_joint=np.arange(N) != 4))
    recursion.push(replace(whole, index=3, has_accelerometer=False))
    after = recursion.snapshot()["sums"]
    assert all(np.array_equal(before[key], after[key]) for key in before)
