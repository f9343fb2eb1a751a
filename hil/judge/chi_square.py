"""Bands of chi-square: between which two ends a value, or the mean of many, lies."""

from scipy.stats import chi2


def ends(dof: int, outside: float = 0.05) -> tuple[float, float]:
    """Return the two ends between which all but a share of chi-square lies, half on either side."""
    return float(chi2.ppf(0.5 * outside, dof)), float(chi2.ppf(1.0 - 0.5 * outside, dof))


def mean_ends(dof: int, count: int, outside: float = 0.05) -> tuple[float, float]:
    """Return the same of the mean of `count` values of `dof` degrees of freedom each."""
    low, high = ends(dof * count, outside)
    return low / count, high / count
