"""The planner's evidence in short: the code of `python -m evidence.excitation`, less of it."""

import pytest

from evidence.excitation import cases
from evidence.excitation.compare import contests
from evidence.excitation.gradients import criterion_error, limits_error
from evidence.excitation.requests import INFEASIBLE, refusal
from evidence.excitation.scatter import scatter
from planner.request import MotionRequest


def test_gradients_agree_with_finite_differences():
    own = cases.subject("both")
    assert criterion_error(own, "sigma") < 1e-5
    assert criterion_error(own, "gamma") < 1e-5
    assert limits_error(own) < 1e-5


def test_the_optimiser_beats_random_motions_within_the_limits():
    (found,) = contests(
        "target", ("sigma",), lambda _text: None, time_ratio=0.0, least_random=30, iterations=30
    )
    assert found.randoms == 30
    assert found.optimised < found.best_random
    assert found.median_random > 2.0 * found.optimised
    assert found.dense_excess < 0
    assert found.truth.ok


def test_the_scatter_is_the_predicted_one():
    request = MotionRequest(duration_s=20.0, iterations=15, candidates=5)
    plan = cases.planner(cases.subject("target"), request).plan()
    found = scatter("target", plan.trajectory, 6)
    # 60 normal values: 4 sigma of their standard deviation is 0.37
    assert abs(found.pooled_ratio - 1) < 0.37
    assert found.not_converged == 0
    assert len(found.outside) <= 1


@pytest.mark.parametrize("name", ["start pose inside the sphere"])
def test_an_impossible_request_is_refused(name):
    error = refusal(INFEASIBLE[name])
    assert error is not None
    assert error.uses[0].excess > 0
