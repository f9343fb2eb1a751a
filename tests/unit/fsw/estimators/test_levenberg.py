"""The iteration's edges: steps that stall, and bodies near the edge of what is possible."""

from __future__ import annotations

import numpy as np

from fsw.estimators.methods.levenberg import _bounded, _settle
from fsw.estimators.methods.system import Options, build_system
from fsw.estimators.model.inertia import to_log_cholesky
from hil.evidence.methods import sample_level
from tests.support.estimator_cases import make_problem


def target_system():
    problem = make_problem(("target",), biases=False)
    return build_system(problem, Options(body_prior=False))


def test_steps_that_stall_leave_the_point_of_least_cost():
    system = target_system()
    x = system.prior_mean
    p = len(x)
    gram = np.zeros((p + 1, p + 1))
    gram[:p, :p] = np.diag(1.0 / x**2 + 1.0)
    gram[:p, p] = gram[p, :p] = 1e-3
    gram[p, p] = 1.0
    worse = gram.copy()
    worse[p, p] = 2.0
    coordinates = x.copy()
    coordinates[:10] = to_log_cholesky(x[:10])
    found_x, found, cost, reached = _settle(
        lambda _x: worse, system, coordinates, (x, gram, 1.0), 1e-12
    )
    assert not reached
    assert cost == 1.0
    np.testing.assert_array_equal(found_x, x)
    np.testing.assert_array_equal(found, gram)


def test_no_step_changes_a_diagonal_by_more_than_e():
    system = target_system()
    step = np.zeros(10)
    step[1] = -30.0
    bounded = _bounded(step, np.full(10, 2.0), system)
    assert np.abs(bounded / 2.0).max() == 1.0


def test_a_start_from_which_plain_steps_leap_to_the_edge_converges():
    """Seed 27 of the study, both unknown, good IMU: 12 times the base's mass before the bound."""
    record = sample_level.run_seed("both", "good IMU", 27, ["rda"])[0]
    assert record.status == "OK"
    assert record.nees < 45.3  # 99.9 % of chi-square with 20 degrees of freedom
