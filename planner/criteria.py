"""Criteria on the information that a motion gives, each with its derivative.

All are functions of the triangular root R of the information F = R^T R of the full state, prior
included, of the root of the torque regressor's Gram matrix M, and of the time integral of |torque|.
Smaller is better. (Roots are used because F and M themselves would lose half of the digits.) Fused
criteria use the covariance C of the reported quantities (mass, centre of mass, central inertia)
with all other states marginalised, in units of the prior sigmas where units must not matter:

    sigma  mean of log sigma (weighted): the geometric mean of the sigmas
    d      log det C / 2 of the quantities with weight        a  trace of W C W
    e      largest eigenvalue of W C W                          W = diag(sqrt(weight) / prior sigma)
    cond   condition number of the stacked torque regressor
    gamma  xi1 cond + xi2 / integral of sum |tau|              eq. (17) of the paper

a, e and cond are minimised in logarithms, e and cond by a power mean of the eigenvalues, which is
smooth where eigenvalues cross.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import solve_triangular

from fsw.messages import FloatArray

Name = Literal["sigma", "d", "a", "e", "cond", "gamma"]
NAMES: tuple[Name, ...] = ("sigma", "d", "a", "e", "cond", "gamma")
REGRESSOR_CRITERIA = ("cond", "gamma")
POWER = 8  # exponent of the power mean that replaces an extreme eigenvalue


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scale:
    """How the states of the bodies become the p reported quantities, and how much each counts.

    The quantities are mass, centre of mass and central inertia of every unknown body [kg, m,
    kg m^2]; the states are its ten moments pi.
    """

    T: FloatArray  # (p, p) d(report)/d(pi)
    prior_sigma: FloatArray  # (p,) of the reported quantities
    weights: FloatArray  # (p,) not negative


@dataclass(frozen=True, slots=True, kw_only=True)
class Gamma:
    """Weights of the paper's criterion: xi1 of the condition number, xi2 [N m s] of the torque."""

    xi1: float
    xi2: float


@dataclass(frozen=True, slots=True, eq=False)
class Value:
    """A criterion to minimise and its derivatives by F, M and the integral of |tau| (effort)."""

    value: float
    by_F: FloatArray | None = None
    by_M: FloatArray | None = None
    by_effort: float = 0.0


def triangular_root(rows: FloatArray) -> FloatArray:
    """Return R (p, p), upper triangular, with R^T R = rows^T rows; `rows` is (k, p), k >= p."""
    return np.asarray(np.linalg.qr(rows, mode="r"), dtype=np.float64)


def prior_root(covariance: FloatArray) -> FloatArray:
    """Return a triangular R with R^T R the inverse of a covariance."""
    L = np.linalg.cholesky(covariance)
    return np.asarray(solve_triangular(L, np.eye(len(L)), lower=True))


def covariance(R: FloatArray, p: int) -> FloatArray:
    """Return the first p columns of the covariance (R^T R)^-1, shape (s, p)."""
    half = solve_triangular(R, np.eye(len(R), p), trans=1)
    return np.asarray(solve_triangular(R, half))


def report_covariance(R: FloatArray, scale: Scale) -> FloatArray:
    """Return the covariance (p, p) of the reported quantities."""
    p = len(scale.T)
    C = scale.T @ covariance(R, p)[:p] @ scale.T.T
    return np.asarray(0.5 * (C + C.T))


def fused(name: str, R: FloatArray, scale: Scale) -> Value:
    """Return a fused criterion and its derivative by F = R^T R."""
    p = len(scale.T)
    columns = covariance(R, p)
    C = scale.T @ columns[:p] @ scale.T.T
    C = 0.5 * (C + C.T)
    w = scale.weights
    if name == "sigma":
        share = w / w.sum()
        variance = np.diag(C)
        value = float(0.5 * share @ np.log(variance))
        by_C = np.diag(0.5 * share / variance)
    elif name == "d":
        keep = np.flatnonzero(w > 0)
        S = scale.prior_sigma[keep]
        part = C[np.ix_(keep, keep)] / np.outer(S, S)
        value = float(0.5 * np.linalg.slogdet(part)[1] / len(keep))
        by_C = np.zeros_like(C)
        inverse = np.linalg.solve(part, np.diag(1.0 / S**2) * S[:, None]) / S[:, None]
        by_C[np.ix_(keep, keep)] = 0.5 * (inverse + inverse.T) / (2 * len(keep))
    elif name == "a":
        W = w / scale.prior_sigma**2
        total = float(W @ np.diag(C))
        value, by_C = 0.5 * np.log(total), np.diag(0.5 * W / total)
    elif name == "e":
        W = np.sqrt(w) / scale.prior_sigma
        values, vectors = np.linalg.eigh(C * np.outer(W, W))
        log, slope = _power_mean(np.maximum(values, 1e-300))
        value = 0.5 * log
        by_C = 0.5 * ((vectors * slope) @ vectors.T) * np.outer(W, W)
    else:
        raise ValueError(f"criterion {name!r} is not a fused one")
    side = columns @ scale.T.T
    return Value(float(value), by_F=-side @ by_C @ side.T)


def regressor(name: str, R: FloatArray, effort: float, gamma: Gamma) -> Value:
    """Return log cond or gamma, with derivatives by M = R^T R and by the effort [N m s]."""
    _, singular, transposed = np.linalg.svd(R)
    values, vectors = np.maximum(singular, 1e-150) ** 2, transposed.T
    top, top_slope = _power_mean(values)
    bottom, bottom_slope = _power_mean(1.0 / values)
    log = 0.5 * (top + bottom)
    slope = 0.5 * (top_slope - bottom_slope / values**2)
    by_M = (vectors * slope) @ vectors.T
    if name == "cond":
        return Value(float(log), by_M=by_M)
    cond = float(np.exp(log))
    return Value(
        gamma.xi1 * cond + gamma.xi2 / effort,
        by_M=gamma.xi1 * cond * by_M,
        by_effort=-gamma.xi2 / effort**2,
    )


def exact_condition(R: FloatArray) -> float:
    """Return the condition number of the regressor with root R."""
    singular = np.linalg.svd(R, compute_uv=False)
    return float(singular[0] / max(singular[-1], 1e-300))


def largest_sigma(R: FloatArray, scale: Scale) -> float:
    """Return the e criterion without the power mean: the largest sigma in prior sigmas."""
    W = np.sqrt(scale.weights) / scale.prior_sigma
    C = report_covariance(R, scale)
    return float(np.sqrt(np.linalg.eigvalsh(C * np.outer(W, W))[-1]))


def _power_mean(values: FloatArray) -> tuple[float, FloatArray]:
    """Return log (sum values^k)^(1/k), k = `POWER`, and the derivative by the values."""
    peak = values.max()
    powers = (values / peak) ** POWER
    total = powers.sum()
    log = np.log(peak) + np.log(total) / POWER
    return float(log), np.asarray(powers / total / values)
