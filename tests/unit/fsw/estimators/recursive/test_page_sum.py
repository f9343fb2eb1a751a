"""Page's sum: rates by the Markov chain against simulation; a limit for every number of rows."""

import numpy as np
import pytest

from fsw.estimators.recursive.page_sum import DRIFT, REACH, mean_blocks_to_alarm, step, threshold


def simulated_rate(dof: int, limit: float, chains: int, blocks: int) -> tuple[float, int]:
    """Return the alarms per block of independent sums that begin again after an alarm."""
    rng = np.random.default_rng(dof)
    total, alarms = np.zeros(chains), 0
    for _ in range(blocks):
        excess = (rng.chisquare(dof, chains) - dof) / np.sqrt(2.0 * dof)
        total = np.maximum(0.0, total + np.minimum(excess, REACH * limit) - DRIFT)
        over = total > limit
        alarms += int(over.sum())
        total[over] = 0.0
    return alarms / (chains * blocks), alarms


@pytest.mark.parametrize(("dof", "limit"), [(52, 3.7), (24, 4.6), (3, 5.2)])
def test_the_rate_is_that_of_simulated_chi_square_sums(dof: int, limit: float) -> None:
    """Within 4 sigma of the simulation's count and 1 % for the width of the cells."""
    rate, alarms = simulated_rate(dof, limit, 20_000, 1500)
    expected = 1.0 / mean_blocks_to_alarm(dof, limit, 500)
    assert alarms > 100
    assert abs(rate / expected - 1.0) < 4.0 / np.sqrt(alarms) + 0.01


@pytest.mark.parametrize("dof", [1, 2, 3, 7, 24, 52, 200])
def test_the_limit_has_its_rate_and_three_blocks_that_fit_nothing_reach_it(dof: int) -> None:
    for rate in (5e-8, 1e-10):
        limit = threshold(dof, rate)
        assert 1.0 / mean_blocks_to_alarm(dof, limit, 400) == pytest.approx(rate, rel=0.06)
        assert step(1e12, dof, rate) < REACH
        assert sum(step(1e12, dof, rate) for _ in range(2)) < 1.0 < 3 * step(1e12, dof, rate)


def test_a_gaussian_bound_is_wrong_for_chi_square() -> None:
    """Limit 12 with drift 1 is exp(-24) = 4e-11 for Gaussian excess; fewer rows, heavier tail."""
    few, many = (1.0 / mean_blocks_to_alarm(dof, 12.0) for dof in (24, 52))
    assert few > 2.0 * many > 20.0 * np.exp(-24.0)
