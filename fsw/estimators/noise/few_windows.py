"""A noise that few windows have shown is uncertain itself: Student's distribution counts this.

The tests that find noise above the declared, and residuals that are alike, need many windows. With
fewer than FEW_WINDOWS, a held arm's noise is therefore that of its residuals, whether a test finds
it or not, and never below the declared. What its joints do not explain may last longer than a
window, and one joint may determine a mass. So a window counts as one sample of the noise, whatever
its number of rows, less the share of it that the fitted parameters have used up. An error over an
estimated sigma follows Student's distribution; sigma grows until 3 sigma are as probable as those
of a Gaussian: 2.2 times with 4 degrees of freedom, 1.3 times with 10, 1.1 times with 24.
Source: Student, Biometrika 6 (1908) 1.
"""

import numpy as np
from scipy.special import ndtri, stdtrit

from fsw.messages import FloatArray

FEW_WINDOWS = 25  # from here on, Student's sigma is at most 11 % wider
THREE_SIGMA = 0.99865  # point at which Student's distribution replaces the Gaussian


def student(dof: FloatArray) -> FloatArray:
    """Return the factors on variances that were estimated with these degrees of freedom."""
    return np.asarray((stdtrit(dof, THREE_SIGMA) / ndtri(THREE_SIGMA)) ** 2)


def few_windows(levels: FloatArray, parameters: float, rows: int) -> tuple[float, float]:
    """Return the ratio of the noise's variance to the declared one, and Student's factor on it.

    Parameters
    ----------
    levels : (k,) mean squared whitened residual of each window, k below FEW_WINDOWS
    parameters : number of them that the data have fitted
    rows : number in a window
    """
    dof = max(1.0, len(levels) - parameters / rows)
    return max(1.0, float(np.sum(levels)) / dof), float(student(np.array(dof)))


def in_words(windows: int, doubt: float) -> str:
    """Return a note that Student's factor `doubt` is used on the variance; empty: it is 1."""
    if doubt == 1.0:
        return ""
    wider = f"{doubt**0.5:.2g} times as wide (Student)"
    shown = f"only {windows} windows show the noise of the joints"
    return f"{shown}: its sigma counts {wider}; record longer"


def too_few(windows: int, least: int) -> str:
    """Return a note that a result needs more windows; empty: there are enough."""
    if windows >= least:
        return ""
    needs = f"a result needs {least} (estimator.settle_blocks)"
    return f"{windows} windows are used; {needs}: record longer"
