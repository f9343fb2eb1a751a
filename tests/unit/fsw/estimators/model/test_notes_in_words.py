"""Notes name a state in words, how far it is off, and the key to correct."""

import numpy as np

from fsw.estimators.model.state_groups import in_words
from tests.support.estimator_cases import make_problem


def test_a_value_far_from_its_prior_is_named_with_size_and_key() -> None:
    problem = make_problem(("target",), doubt=True)
    x = problem.prior_mean.copy()
    place = problem.names.index("joint_zero.joint2")
    x[place] += 11.0 * np.sqrt(problem.prior_covariance[place, place])
    note = problem.suspicion(x)
    assert "joint zeros (joint2): estimated 11 sigma (+0.022 rad) from" in note
    assert "joints[].zero_sigma_rad" in note
    assert "joint_zero" not in note


def test_a_known_body_is_named_without_the_number_of_its_parameter() -> None:
    assert in_words("known.base.7") == "inertial data of known bodies and links (base)"
    assert in_words("target.mass") == "target.mass"
