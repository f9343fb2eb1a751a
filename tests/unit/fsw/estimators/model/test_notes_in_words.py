"""Notes name a state in words, how far it is off, and the key to correct."""

import numpy as np

from fsw.estimators.model.state_groups import in_words
from fsw.estimators.noise.few_windows import in_words as few
from fsw.estimators.noise.likeness import in_words as widening
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


def test_a_torque_that_counts_the_other_way_is_named() -> None:
    problem = make_problem(("target",), doubt=True)
    x = problem.prior_mean.copy()
    x[problem.names.index("torque_scale.joint2")] -= 1.97
    note = problem.suspicion(x)
    assert "torque scale (joint2): estimated 197 sigma (-1.97) from" in note
    assert "set torque_gain to -1 times its value" in note


def test_the_name_of_a_group_has_no_empty_brackets() -> None:
    assert in_words("torque_scale") == "torque scale"


def test_a_known_body_is_named_without_the_number_of_its_parameter() -> None:
    assert in_words("known.base.7") == "inertial data of known bodies and links (base)"
    assert in_words("target.mass") == "target.mass"


def test_a_state_of_a_body_is_named_by_its_quantity() -> None:
    problem = make_problem(("target",))
    words = [in_words(name) for name in problem.names[problem.body("target")]]
    assert words[0] == "mass of target"
    assert words[3] == "mass times centre of mass z of target"
    assert words[5] == "inertia xy of target"
    assert len(set(words)) == 10


def test_wider_sigma_is_told_with_quantity_size_and_cure() -> None:
    problem = make_problem(("target",))
    names = problem.names[problem.body("target")]
    note = widening(np.eye(10), np.diag([1.0] * 9 + [6.25]), names)
    assert "sigma is wider, of inertia zz of target 2.5 times" in note
    assert "declare" in note
    assert "record longer" in few(4, 4.0)
