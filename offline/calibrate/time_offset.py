"""Time offset between star tracker and gyro, from the rotations that both measure.

The rotation between two solutions is compared with the gyro's integral over the same time, shifted
by each offset of a grid. A parabola through the log-likelihoods near the best grid point gives the
offset; its curvature gives sigma. Bias and a small mounting error are estimated at every offset.
"""

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.linalg import cholesky_banded, solve_banded
from scipy.spatial.transform import Rotation

from fsw.estimators.model.inertia import skew
from fsw.messages import FloatArray

MOST_S, STEP_S = 0.3, 0.01  # largest trial offset and step of the grid
HALF_PEAK = 6  # grid points on each side of the best one that the parabola is fitted to
GAP_STEPS = 3.0  # gyro periods; the gyro's integral over a longer gap is unknown
LEAST_TURNS = 10
LEAST_GAIN = 100.0  # least fall of the cost due to the gyro; noise alone never reaches it
NOTHING_RAD2 = 1.0  # variance of a rotation that is unknown


def tracker_offset(
    t_s: FloatArray,
    R_NB: Rotation,
    gyro_s: FloatArray,
    w_rad_s: FloatArray,
    sigma_rad: FloatArray,
    walk_rad_sqrt_s: float,
) -> tuple[float, float]:
    """Return by how much solutions are older than their stamps say, and 1 sigma [s].

    The result is (nan, inf) if there is no peak within MOST_S, or too little rotation or data.

    Parameters
    ----------
    t_s : (n,) stamps of the solutions R_NB, here rotations from the tracker's axes to N
    gyro_s : (k,) stamps, at least one, of the rates w_rad_s (k, 3), in the tracker's axes
    sigma_rad : (3,) 1 sigma of a solution about the tracker's axes
    walk_rad_sqrt_s : angle random walk of the gyro [rad/sqrt(s)]
    """
    inside = (t_s > gyro_s[0] + MOST_S) & (t_s < gyro_s[-1] - MOST_S)
    if np.count_nonzero(inside) <= LEAST_TURNS:
        return np.nan, np.inf
    t_s, R_NB = t_s[inside], R_NB[inside]
    turned = (R_NB[:-1].inv() * R_NB[1:]).as_rotvec()
    angle = cumulative_trapezoid(w_rad_s, gyro_s, axis=0, initial=0)

    def integral(offset_s: float) -> FloatArray:
        at = [np.interp(t_s - offset_s, gyro_s, angle[:, axis]) for axis in range(3)]
        return np.diff(np.array(at).T, axis=0)

    steps = np.diff(t_s)
    variance = walk_rad_sqrt_s**2 * steps + np.where(_broken(t_s, gyro_s), NOTHING_RAD2, 0.0)
    roots = [_root(variance, sigma) for sigma in sigma_rad.tolist()]
    nuisance = np.concatenate([steps[:, None, None] * np.eye(3), skew(integral(0.0))], axis=2)
    basis = np.linalg.qr(_white(roots, nuisance).reshape(-1, 6))[0]

    def unexplained(turns: FloatArray) -> float:
        left = _white(roots, turns[:, :, None]).ravel()
        return float(left @ left - np.sum((basis.T @ left) ** 2))

    steps_back = round(MOST_S / STEP_S)
    grid = STEP_S * np.arange(-steps_back, steps_back + 1)
    costs = np.array([unexplained(turned - integral(offset_s)) for offset_s in grid])
    best = int(np.argmin(costs))
    near = slice(best - HALF_PEAK, best + HALF_PEAK + 1)
    is_peak = HALF_PEAK <= best < len(grid) - HALF_PEAK
    if not is_peak or unexplained(turned) - costs[best] < LEAST_GAIN:
        return np.nan, np.inf
    bend, slope, _ = np.polyfit(grid[near] - grid[best], costs[near], 2)
    if bend <= 0.0:
        return np.nan, np.inf
    noise = max(1.0, costs[best] / (3 * len(steps) - 7))  # ratio to the declared variance
    return float(grid[best] - 0.5 * slope / bend), float(np.sqrt(noise / bend))


def _broken(t_s: FloatArray, gyro_s: FloatArray) -> FloatArray:
    """Return (n - 1,): whether a gap of the gyro lies between or near two successive solutions."""
    steps = np.diff(gyro_s)
    gaps = steps > GAP_STEPS * np.median(steps)
    begun = np.searchsorted(gyro_s[:-1][gaps], t_s[1:] + MOST_S)
    return np.asarray(begun > np.searchsorted(gyro_s[1:][gaps], t_s[:-1] - MOST_S))


def _root(variance: FloatArray, sigma: float) -> FloatArray:
    """Return the banded Cholesky root (lower) of the covariance of rotations about one axis.

    Successive rotations share a solution: tridiag(-sigma^2, 2 sigma^2 + variance, -sigma^2).
    """
    bands = np.stack([2.0 * sigma**2 + variance, np.full(len(variance), -(sigma**2))])
    return np.asarray(cholesky_banded(bands, lower=True), np.float64)


def _white(roots: list[FloatArray], values: FloatArray) -> FloatArray:
    """Return values (n, 3, k) multiplied by the inverse root of each axis, so noise is white."""
    white = [solve_banded((1, 0), root, values[:, axis]) for axis, root in enumerate(roots)]
    return np.stack(white, axis=1)
