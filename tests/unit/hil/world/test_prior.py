import numpy as np
import pytest

from hil.world.inertia import is_physical
from hil.world.prior import draw_prior
from hil.world.scenario import load

DIAGONAL = [0, 4, 7, 9]


@pytest.mark.parametrize("name", ["target_leo", "target_geo", "base"])
def test_priors_are_off_by_thirty_to_fifty_percent_and_physical(name):
    scenario = load(name)
    body = scenario.unknown[0]
    truth = scenario.truth[body]
    for seed in range(50):
        prior = draw_prior(truth, seed, body)
        off = np.abs(prior.report / truth - 1)[DIAGONAL]
        assert np.all((off >= 0.3 - 1e-12) & (off <= 0.5 + 1e-12))
        com = np.linalg.norm(prior.report[1:4] - truth[1:4]) / np.linalg.norm(truth[1:4])
        assert 0.3 <= com <= 0.6  # each component by 30-50 % of itself or of 0.3 |c|
        assert is_physical(prior.report)


def test_prior_errors_are_as_large_as_their_sigma_says():
    truth = load("base").truth["base"]
    z = []
    for seed in range(300):
        prior = draw_prior(truth, seed, "base")
        z.append((prior.report - truth) / prior.sigma)
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    # 0.4/(1 +- 0.4) over 0.5 is 0.57 or 1.33, about 1 together; rejection prefers one sign
    assert np.all((rms > 0.5) & (rms < 1.6)), rms


def test_sigma_is_a_function_of_the_prior_alone():
    truth = load("target_leo").truth["target"]
    prior = draw_prior(truth, 3, "target")
    assert prior.sigma[0] == pytest.approx(0.5 * prior.report[0])


def test_seeds_and_bodies_draw_differently_and_repeatably():
    truth = load("target_leo").truth["target"]
    first = draw_prior(truth, 1, "target").report
    assert np.array_equal(first, draw_prior(truth, 1, "target").report)
    assert not np.array_equal(first, draw_prior(truth, 2, "target").report)
    assert not np.array_equal(first, draw_prior(truth, 1, "base").report)
