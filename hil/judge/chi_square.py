"""Bands of the chi-square distribution, for one value or the mean of many."""

from scipy.stats import chi2


def ends(dof: int, outside: float = 0.05) -> tuple[float, float]:
    """Return both ends of the central band; each tail has the probability 0.5 `outside`."""
    return float(chi2.ppf(0.5 * outside, dof)), float(chi2.ppf(1.0 - 0.5 * outside, dof))


def mean_ends(dof: int, count: int, outside: float = 0.05) -> tuple[float, float]:
    """Return both ends for the mean of `count` values with `dof` degrees of freedom each."""
    low, high = ends(dof * count, outside)
    return low / count, high / count
