"""Inertial parameters of one body: conventions, frames and physical consistency.

The ten parameters are Pinocchio's `toDynamicParameters` order about the body-frame origin,
pi = [m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz]; the paper's eq. (1) has Iyy and Ixz
exchanged. Outside the estimators a body is (mass, centre of mass, inertia about the centre of mass
as xx xy xz yy yz zz).
"""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from scipy.linalg import solve_triangular

from fsw.messages import FloatArray

PARAMETERS = 10
NAMES = ("m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
PAPER_ORDER = (0, 1, 2, 3, 4, 5, 7, 6, 8, 9)  # eq. (1) from pi, and back (its own inverse)
_SYMMETRIC = np.array(((0, 1, 3), (1, 2, 4), (3, 4, 5)))  # pi[4:] as a matrix
_REPORT = np.array(((0, 1, 2), (1, 3, 4), (2, 4, 5)))  # xx xy xz yy yz zz as a matrix
_REPORT_INDEX = ((0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2))
_ROW_COLUMN, _SIX = np.array(_REPORT_INDEX), np.arange(6)
_DIAGONAL = (_ROW_COLUMN[0] == _ROW_COLUMN[1]).astype(float)
_PI_INDEX = ((0, 0, 1, 0, 1, 2), (0, 1, 1, 2, 2, 2))


def skew(v: FloatArray) -> FloatArray:
    """Return [v x], (..., 3, 3), for vectors (..., 3)."""
    S = np.zeros((*v.shape[:-1], 3, 3))
    S[..., 0, 1], S[..., 0, 2] = -v[..., 2], v[..., 1]
    S[..., 1, 0], S[..., 1, 2] = v[..., 2], -v[..., 0]
    S[..., 2, 0], S[..., 2, 1] = -v[..., 1], v[..., 0]
    return S


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return a x b of vectors (..., 3); five times as fast as numpy's on a few of them."""
    c = np.empty(np.broadcast_shapes(a.shape, b.shape))
    c[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    c[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    c[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return c


def to_parameters(mass_kg: float, com_m: FloatArray, inertia_kg_m2: FloatArray) -> FloatArray:
    """Return pi (10,) from mass, centre of mass (3,) and central inertia (6,) xx xy xz yy yz zz.

    Source: Huygens-Steiner, I_O = I_C + m (c.c 1 - c c^T).
    """
    c = np.asarray(com_m, float)
    central = np.asarray(inertia_kg_m2, float)[_REPORT]
    origin = central + mass_kg * (c @ c * np.eye(3) - np.outer(c, c))
    return np.concatenate(([mass_kg], mass_kg * c, origin[_PI_INDEX]))


def from_parameters(pi: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Return mass, centre of mass (3,) and central inertia (6,) xx xy xz yy yz zz of pi (10,)."""
    return float(pi[0]), pi[1:4] / pi[0], about_com(pi)[_REPORT_INDEX]


def report_jacobian(pi: FloatArray) -> FloatArray:
    """Return d(mass, com, central inertia)/d pi, (10, 10)."""
    m, c = pi[0], pi[1:4] / pi[0]
    J = np.zeros((10, 10))
    J[0, 0] = 1.0
    J[1:4, 0], J[1:4, 1:4] = -c / m, np.eye(3) / m
    # central = origin - (h.h 1 - h h^T)/m with h = m c
    i, j = _ROW_COLUMN
    row, diagonal, central = _SIX, _DIAGONAL, J[4:]
    central[row, 4 + _SYMMETRIC[i, j]] = 1.0
    central[:, 0] = (c @ c) * diagonal - c[i] * c[j]
    central[:, 1:4] = -2.0 * diagonal[:, None] * c
    central[row, 1 + i] += c[j]
    central[row, 1 + j] += c[i]
    return J


def about_origin(pi: FloatArray) -> FloatArray:
    """Return the inertia matrix (3, 3) of pi (10,) about its frame's origin [kg m2]."""
    found: FloatArray = pi[4:][_SYMMETRIC]
    return found


def about_com(pi: FloatArray) -> FloatArray:
    """Return the inertia matrix (3, 3) of pi (10,) about its centre of mass [kg m2]."""
    m, c = pi[0], pi[1:4] / pi[0]
    central: FloatArray = about_origin(pi) - m * (c @ c * np.eye(3) - np.outer(c, c))
    return central


def pseudo_inertia(pi: FloatArray) -> FloatArray:
    """Return the 4 x 4 pseudo-inertia [[Sigma, h], [h^T, m]] with Sigma = tr(I)/2 1 - I.

    The body is physically consistent iff it is positive definite. Source: Wensing, Kim, Slotine
    (RA-L 2018), eq. (10).
    """
    origin = pi[4:][_SYMMETRIC]
    P = np.empty((4, 4))
    P[:3, :3] = 0.5 * np.trace(origin) * np.eye(3) - origin
    P[:3, 3] = P[3, :3] = pi[1:4]
    P[3, 3] = pi[0]
    return P


def from_pseudo_inertia(P: FloatArray) -> FloatArray:
    """Return pi (10,) of a pseudo-inertia matrix; inverse of `pseudo_inertia`."""
    origin = np.trace(P[:3, :3]) * np.eye(3) - P[:3, :3]
    return np.concatenate(([P[3, 3]], P[:3, 3], origin[_PI_INDEX]))


def is_consistent(pi: FloatArray) -> bool:
    """Return whether the pseudo-inertia is finite and positive definite."""
    if not np.all(np.isfinite(pi)):
        return False
    return bool(np.linalg.eigvalsh(pseudo_inertia(pi))[0] > 0)


@lru_cache(maxsize=1)
def parameter_basis() -> FloatArray:
    """Return (10, 4, 4): the pseudo-inertia of each unit parameter; `pseudo_inertia` is linear."""
    basis = np.stack([pseudo_inertia(e) for e in np.eye(PARAMETERS)])
    basis.setflags(write=False)
    return basis


@lru_cache(maxsize=1)
def parameters_of_pseudo_inertia() -> FloatArray:
    """Return (10, 16): `from_pseudo_inertia` as a matrix on the flattened pseudo-inertia."""
    return np.stack([from_pseudo_inertia(e.reshape(4, 4)) for e in np.eye(16)], axis=1)


def frame_changes(X_AB: FloatArray) -> FloatArray:
    """Return T (k, 10, 10) with pi_A = T pi_B for homogeneous transforms X_AB (k, 4, 4).

    The pseudo-inertia transforms as X P X^T. On the 16 elements of P, row by row, this is the
    Kronecker product of X with itself. Source: Wensing et al. (2018), sec. II.
    """
    X_X = (X_AB[:, :, None, :, None] * X_AB[:, None, :, None, :]).reshape(-1, 16, 16)
    basis = parameter_basis().reshape(PARAMETERS, 16).T
    changes: FloatArray = parameters_of_pseudo_inertia() @ (X_X @ basis)
    return changes


def frame_change(R_AB: FloatArray, p_AB_m: FloatArray) -> FloatArray:
    """Return T (10, 10) with pi_A = T pi_B for one body seen from frames A and B.

    `R_AB` takes B components to A; `p_AB_m` is B's origin in A.
    """
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R_AB, p_AB_m
    change: FloatArray = frame_changes(X[None])[0]
    return change


_LOWER = ((0, 1, 2, 3, 1, 2, 3, 2, 3, 3), (0, 1, 2, 3, 0, 1, 2, 0, 1, 0))


def from_log_cholesky(theta: FloatArray) -> FloatArray:
    """Return pi of the log-Cholesky coordinates (10,): always physically consistent.

    P = L L^T, L lower triangular with exp of the first four coordinates on its diagonal.
    Source: Rucker, Wensing (RA-L 2022), up to the order of the coordinates.
    """
    L = np.zeros((4, 4))
    L[_LOWER] = theta
    L[np.diag_indices(4)] = np.exp(theta[:4])
    return from_pseudo_inertia(L @ L.T)


def to_log_cholesky(pi: FloatArray) -> FloatArray:
    """Return the log-Cholesky coordinates of a physically consistent pi.

    Raises
    ------
    numpy.linalg.LinAlgError if the pseudo-inertia is not positive definite.
    """
    L = np.linalg.cholesky(pseudo_inertia(pi))
    theta = np.array(L[_LOWER])
    theta[:4] = np.log(theta[:4])
    return theta


def log_cholesky_jacobian(theta: FloatArray) -> FloatArray:
    """Return d pi / d theta, (10, 10), of `from_log_cholesky`."""
    L = np.zeros((4, 4))
    L[_LOWER] = theta
    L[np.diag_indices(4)] = np.exp(theta[:4])
    J = np.empty((10, 10))
    for k, (i, j) in enumerate(zip(*_LOWER, strict=True)):
        dL = np.zeros((4, 4))
        dL[i, j] = L[i, j] if i == j else 1.0
        J[:, k] = from_pseudo_inertia(dL @ L.T + L @ dL.T)
    return J


_UNIT_PSEUDO_INERTIAS = np.stack([pseudo_inertia(e) for e in np.eye(PARAMETERS)])
ROUNDING = 1e-12  # added to a correlation's diagonal where it has no Cholesky factor otherwise
_GAP = 1e-6  # accuracy of the squared distance: relative, or absolute where it is below 1


def nearest_consistent(pi: FloatArray, covariance: FloatArray, margin: float = 1e-3) -> FloatArray:
    """Return the physically consistent parameters closest to `pi` in the covariance's metric.

    This is a convex problem: minimise |y|^2 / 2 subject to P(pi + W y) >= 0 with W W^T the
    covariance. Newton steps with the barrier -mu log det P solve it from inside the consistent set.
    `pi` itself is returned if it is consistent. `margin` is the smallest over the largest
    pseudo-inertia eigenvalue of the start. The result is strictly consistent; its squared distance
    exceeds the least one by at most 1e-6 (relative, or in sigma squared when below one).

    Source: Boyd, Vandenberghe, Convex Optimization (2004), sec. 11.3 (gap: 4 mu for a 4 x 4 P).
    """
    if is_consistent(pi):
        return pi
    W = _root(covariance)
    directions = (W.T @ _UNIT_PSEUDO_INERTIAS.reshape(PARAMETERS, 16)).reshape(PARAMETERS, 4, 4)
    values, vectors = np.linalg.eigh(pseudo_inertia(pi))
    clipped = np.maximum(values, margin * max(abs(values[-1]), abs(values[0]), 1e-9))
    x = from_pseudo_inertia((vectors * clipped) @ vectors.T)
    y = solve_triangular(W, x - pi, lower=True)
    mu = max(float(y @ y), 1.0)
    for _ in range(200):
        root = np.linalg.cholesky(pseudo_inertia(x))
        F = np.linalg.solve(root, np.linalg.solve(root, directions).swapaxes(1, 2))
        F = F.reshape(PARAMETERS, 16)
        gradient = y - mu * F[:, ::5].sum(axis=1)
        step = -np.linalg.solve(np.eye(PARAMETERS) + mu * (F @ F.T), gradient)
        rates = np.linalg.eigvalsh((step @ F).reshape(4, 4))
        length = _line_search(float(y @ step), float(step @ step), mu, rates)
        y = y + length * step
        x = pi + W @ y
        if -float(gradient @ step) < 0.1 * mu:  # on the path: Newton's decrement is small
            if 8 * mu < _GAP * max(float(y @ y), 1.0):
                break
            mu *= 0.05
    return x


def consistent_state(
    x: FloatArray, bodies: Sequence[slice], covariance: Callable[[], FloatArray], off: FloatArray
) -> FloatArray:
    """Return a state with each of its bodies moved to the nearest consistent one.

    Parameters
    ----------
    x : (p,) state; returned itself where all bodies are consistent
    bodies : the ten states of each body
    covariance : returns the covariance of the state (p, p)
    off : (p,) parameters of modes that the states of a body include; they are not moved
    """
    moved = x
    for k in bodies:
        if not is_consistent(x[k] - off[k]):
            moved = x.copy() if moved is x else moved
            moved[k] = off[k] + nearest_consistent(x[k] - off[k], covariance()[k, k])
    return moved


def _root(covariance: FloatArray) -> FloatArray:
    """Return a lower root of a covariance that may be singular within rounding."""
    try:
        return np.asarray(np.linalg.cholesky(covariance), np.float64)
    except np.linalg.LinAlgError:
        scale = np.sqrt(np.diag(covariance))
        correlation = covariance / np.outer(scale, scale) + ROUNDING * np.eye(len(scale))
        return np.asarray(scale[:, None] * np.linalg.cholesky(correlation), np.float64)


def _line_search(slope: float, curvature: float, mu: float, rates: FloatArray) -> float:
    """Return the step that minimises slope t + curvature t^2 / 2 - mu sum log(1 + rates t).

    The function is convex; Newton steps are kept inside (0, end of the domain).
    """
    end = 1.0 / max(float(-rates.min()), 1e-300)
    t = min(1.0, 0.5 * end)
    for _ in range(4):
        scaled = [rate / (1.0 + rate * t) for rate in rates.tolist()]
        first = slope + curvature * t - mu * sum(scaled)
        second = curvature + mu * sum(value * value for value in scaled)
        t = min(max(t - first / second, 0.1 * t), t + 0.9 * (end - t))
    return t
