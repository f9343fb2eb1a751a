import numpy as np
import pytest
from scipy import stats

from hil.judge import chi_square


def test_the_ends_leave_half_of_the_share_on_either_side():
    low, high = chi_square.ends(30, 0.1)
    assert stats.chi2.cdf(low, 30) == pytest.approx(0.05)
    assert stats.chi2.sf(high, 30) == pytest.approx(0.05)


def test_means_of_many_values_lie_between_their_ends_as_often_as_stated():
    means = np.random.default_rng(0).chisquare(10, (20_000, 5)).mean(axis=1)
    low, high = chi_square.mean_ends(10, 5)
    for outside in (means < low, means > high):
        assert outside.mean() == pytest.approx(0.025, abs=4.0 * np.sqrt(0.025 / 20_000))
