"""The methods' rows: a measurement that is missing has no part in them."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.estimators.measurement.row_functions import row_function
from tests.support.estimator_cases import N, make_problem, random_block


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
