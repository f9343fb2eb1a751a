"""The covariance that a run of a weakly known base publishes by way of the mobility."""

import numpy as np
from scipy.stats import chi2

from fsw.estimators.recursive.online import build_online
from tests.support.estimator_cases import noisy_blocks, robot_model
from tests.support.starts import config_of, truth_of


def test_the_recursion_s_covariance_of_a_weakly_known_base_is_honest():
    """RDA online, base alone: NEES of 4 runs in its 99.9 % band; the linear one's is above it."""
    mapped = linear = 0.0
    seeds = 8
    for seed in range(seeds):
        online = build_online(config_of("base", seed, method="rda"), robot_model())
        for block in noisy_blocks("base", seed):
            online.push(block)
        final, truth = online.finish(), truth_of("base")
        error = final.mean[:10] - truth
        plain = online.recursion.memory.information.covariance()
        mapped += error @ np.linalg.solve(final.covariance[:10, :10], error)
        linear += error @ np.linalg.solve(plain[:10, :10], error)
    low, high = chi2.ppf([5e-4, 1 - 5e-4], 10 * seeds)
    assert low <= mapped <= high
    assert mapped < linear
