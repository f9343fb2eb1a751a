"""Liquid in an unknown body widens what is published of it, not what is weighed."""

import numpy as np
import pytest

from fsw.config import Config
from fsw.estimators.measurement.row_functions import row_function
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.inertia import to_parameters
from fsw.estimators.recursive.online import OnlineEstimator
from tests.support.estimator_cases import make_config, noisy_blocks, robot_model

LIQUID = [{"mass_kg": 25.0, "place_m": (0.8, 0.0, 0.1), "stroke_m": 0.2}]


def config(liquid: list[dict[str, object]]) -> Config:
    document = make_config(("base",), target=None).model_dump(mode="json")
    document["bodies"]["base"]["liquid"] = liquid
    return Config.model_validate(document)


def estimator(liquid: list[dict[str, object]]) -> OnlineEstimator:
    chosen = config(liquid)
    problem = build_problem(chosen, robot_model())
    rows = row_function("fused", "eiv", problem)
    return OnlineEstimator(problem, chosen.estimator, rows, linear=False)


def test_a_body_without_its_liquid_is_one_sigma_off():
    """Along each way the liquid may go, the covariance is its square; a sum has their sum."""
    problem = build_problem(config(LIQUID), robot_model())
    assert not build_problem(config([]), robot_model()).liquid.any()
    place = np.array([0.8, 0.0, 0.1])
    gone = to_parameters(25.0, place, np.zeros(6))
    k = problem.bodies
    assert problem.liquid[0, 0] == pytest.approx(25.0**2)
    aside = to_parameters(25.0, place + np.array([0.2, 0, 0]), np.zeros(6)) - gone
    assert problem.liquid[1, 1] == pytest.approx(gone[1] ** 2 + aside[1] ** 2)
    assert not problem.liquid[k.stop :, k.stop :].any()


def test_what_is_published_is_wider_and_the_estimate_the_same():
    with_it, without = estimator(LIQUID), estimator([])
    for block in noisy_blocks("base", 3)[:30]:
        wide, narrow = with_it.push(block), without.push(block)
    assert np.array_equal(wide.mean, narrow.mean)
    assert np.allclose(wide.covariance - narrow.covariance, with_it.problem.liquid, atol=1e-9)
    assert wide.bodies["base"].mass_sigma_kg > 25.0
    assert wide.condition_number == narrow.condition_number
