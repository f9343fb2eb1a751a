"""The flight software's side of a study: a prior as wide as a study wants it."""

import numpy as np
import pytest

from evidence.methods.cases import WIDER
from evidence.methods.flight_side import priors_of, problem_of, write_config
from evidence.paper.cases import ALL, PAPER_SEED, scenario_of


@pytest.mark.parametrize("system", ["target", "both"])
def test_a_study_may_doubt_its_prior_more_than_a_file_may(system, tmp_path):
    scenario = scenario_of("geo", system, ALL)
    wide = write_config(scenario, PAPER_SEED, tmp_path, WIDER)
    right = write_config(scenario, PAPER_SEED, tmp_path)
    for body, prior in priors_of(scenario, PAPER_SEED).items():
        told = wide.bodies[body].sigma
        sigma = np.r_[told.mass_kg, told.com_m, told.inertia_kg_m2]
        assert np.allclose(sigma, WIDER * prior.sigma, rtol=1e-12)
    wider, own = (np.diag(problem_of(c).prior_covariance) for c in (wide, right))
    bodies = problem_of(wide).bodies
    assert np.all(wider[bodies] > own[bodies])
