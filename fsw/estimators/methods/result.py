"""What a batch method returns: estimate, what the data said, and in plain words how good it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import solve_triangular

from fsw.estimators.batch.curvature import Widening
from fsw.estimators.methods.system import Options, System
from fsw.estimators.model.inertia import (
    from_parameters,
    is_consistent,
    nearest_consistent,
    report_jacobian,
)
from fsw.messages import BodyEstimate, FloatArray
from fsw.messages.errors import EstimatorError

Status = Literal["OK", "NOT_CONVERGED", "INSUFFICIENT_EXCITATION"]

KNOWN_BY_DATA = 1.0  # information of the data over the prior's above which the data rules


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Direction:
    """A combination of states and who knows it: variance ratio data over prior along it."""

    vector: FloatArray  # (p,) in units of the prior's sigmas
    information_ratio: float
    known_by: Literal["data", "prior"]
    text: str  # the largest contributions


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BatchResult:
    """Mean and covariance never stand without status, bias note and consistency."""

    method: str
    status: Status
    names: tuple[str, ...]
    mean: FloatArray  # (p,) the unconstrained least squares where the method has one
    covariance: FloatArray  # (p, p); a biased method's includes its estimated bias
    bias: FloatArray  # (p,) estimated bias of the mean, zero for a consistent method
    bias_note: str  # empty: consistent, and Gaussian as far as was looked
    crb: FloatArray  # (p, p) bound at the estimate, prior included as in the method
    information: FloatArray  # (p, p) of the data alone
    bodies: dict[str, BodyEstimate]  # physically consistent
    iterations: int
    cost: float
    rows: int
    condition_number: float  # of the bodies' data information, columns scaled
    duration_s: float
    verdict: str

    @property
    def correlation(self) -> FloatArray:
        """Return the correlation matrix of the estimate."""
        sigma = np.sqrt(np.diag(self.covariance))
        correlation: FloatArray = self.covariance / np.outer(sigma, sigma)
        return correlation

    @property
    def efficiency(self) -> FloatArray:
        """Return bound over variance for every state, 1 where nothing more can be had."""
        ratio: FloatArray = np.diag(self.crb) / np.diag(self.covariance)
        return ratio


def build_result(
    system: System,
    options: Options,
    *,
    method: str,
    x: FloatArray,
    information: FloatArray,
    cost: float,
    rows: int,
    duration_s: float,
    iterations: int = 1,
    converged: bool = True,
    covariance: FloatArray | None = None,
    bias: FloatArray | None = None,
    bias_note: str = "",
    widening: Widening | None = None,
) -> BatchResult:
    """Assemble a result; `information` is the data's, `covariance` (None: the bound) the method's.

    `widening` replaces the covariance where the linearisation was found not to hold.

    INSUFFICIENT_EXCITATION: the data alone leaves the bodies' scaled information worse conditioned
    than the limit and no prior fills the gap, or the information is not positive definite.
    """
    k = system.problem.bodies
    condition = marginal_condition(information, k, system)
    try:
        crb = invert(information + system.prior_information)
    except EstimatorError:
        crb = system.prior_covariance.copy()
        covariance, condition = None, float("inf")
    covariance = crb if covariance is None else covariance
    bias = np.zeros(len(x)) if bias is None else bias
    covariance = covariance + np.outer(bias, bias)
    if widening is not None and widening.nonlinear and np.isfinite(condition):
        covariance = widening.covariance
        bias_note = "; ".join(note for note in (bias_note, widening.note) if note)
    unbounded = widening is not None and not widening.bounded
    status: Status = "OK"
    if unbounded or not condition < options.condition_limit**2:
        status = "INSUFFICIENT_EXCITATION"
    elif not converged:
        status = "NOT_CONVERGED"
    bodies = {name: _body(x, covariance, system, name) for name in system.problem.unknown}
    return BatchResult(
        method=method,
        status=status,
        names=system.names,
        mean=x,
        covariance=covariance,
        bias=bias,
        bias_note=bias_note,
        crb=crb,
        information=information,
        bodies=bodies,
        iterations=iterations,
        cost=cost,
        rows=rows,
        condition_number=float(np.sqrt(condition)),
        duration_s=duration_s,
        verdict=verdict(bodies, status, duration_s, options.wanted_accuracy),
    )


def invert(information: FloatArray) -> FloatArray:
    """Return the inverse of a symmetric positive definite matrix, scaled first.

    Raises
    ------
    EstimatorError if it is not positive definite within rounding.
    """
    diagonal = np.diag(information)
    if not (np.all(np.isfinite(information)) and np.all(diagonal > 0)):
        raise EstimatorError("information is singular: some state is not observable")
    scale = np.sqrt(diagonal)
    try:
        L = np.linalg.cholesky(information / np.outer(scale, scale))
    except np.linalg.LinAlgError as error:
        raise EstimatorError("information is singular: some state is not observable") from error
    root = solve_triangular(L, np.eye(len(scale)), lower=True) / scale
    inverse: FloatArray = root.T @ root
    return inverse


def marginal_condition(information: FloatArray, k: slice, system: System) -> float:
    """Return the condition number of the bodies' own information, nuisances at their priors.

    The information is the data's, nuisances eliminated; rows and columns scaled to unit diagonal,
    so a number squared compared with a regressor's. Infinite if not positive definite.
    """
    total = information.copy()
    rest = slice(k.stop, len(total))
    own = total[k, k]
    if rest.stop > rest.start:
        nuisance = total[rest, rest] + system.prior_information[rest, rest]
        own = own - total[k, rest] @ np.linalg.solve(nuisance, total[rest, k])
    if system.prior_information[k, k].any():
        own = own + system.prior_information[k, k]
    diagonal = np.diag(own)
    if not np.all(diagonal > 0):
        return float("inf")
    values = np.linalg.eigvalsh(own / np.sqrt(np.outer(diagonal, diagonal)))
    return float(values[-1] / values[0]) if values[0] > 0 else float("inf")


def directions(result: BatchResult, system: System) -> tuple[Direction, ...]:
    """Return the eigenvectors of the prior-whitened information, best known first.

    Along each, the ratio says by how much the data outweighs the prior; below one the combination
    is known from the prior only.
    """
    L = np.linalg.cholesky(system.prior_covariance)
    values, vectors = np.linalg.eigh(L.T @ result.information @ L)
    found = []
    for value, column in zip(values[::-1], vectors.T[::-1], strict=True):
        combination = L @ column / np.sqrt(np.diag(system.prior_covariance))
        largest = np.argsort(-np.abs(combination))[:3]
        text = " ".join(f"{combination[i]:+.2f} {result.names[i]}" for i in largest)
        known = "data" if value > KNOWN_BY_DATA else "prior"
        found.append(
            Direction(
                vector=combination,
                information_ratio=float(value),
                known_by="data" if known == "data" else "prior",
                text=text,
            )
        )
    return tuple(found)


def verdict(
    bodies: dict[str, BodyEstimate], status: Status, duration_s: float, wanted: float
) -> str:
    """Say how well the masses are known and how long it takes to know them as wanted.

    Information grows in proportion to the time of comparable motion, so sigma falls as 1/sqrt(t).
    """
    if status != "OK":
        return {
            "NOT_CONVERGED": "not identified: the iteration did not converge",
            "INSUFFICIENT_EXCITATION": "not identified: the motion does not excite all parameters",
        }[status]
    parts = []
    for name, body in bodies.items():
        relative = body.mass_sigma_kg / body.mass_kg
        text = f"{name} mass identified to ±{100 * relative:.2g} %"
        if relative > wanted:
            more = duration_s * ((relative / wanted) ** 2 - 1.0)
            text += f", needs {more:.0f} s more for ±{100 * wanted:.2g} %"
        parts.append(text)
    return "; ".join(parts)


def _body(x: FloatArray, covariance: FloatArray, system: System, name: str) -> BodyEstimate:
    k = system.problem.body(name)
    pi, own = x[k], covariance[k, k]
    consistent = is_consistent(pi)
    if not consistent:
        metric = own if np.all(np.isfinite(pi)) else system.prior_covariance[k, k]
        finite = np.where(np.isfinite(pi), pi, system.prior_mean[k])
        pi = nearest_consistent(finite, metric)
    mass, com, inertia = from_parameters(pi)
    J = report_jacobian(pi)
    sigma = np.sqrt(np.diag(J @ own @ J.T))
    return BodyEstimate(
        mass_kg=mass,
        com_m=com,
        inertia_kg_m2=inertia,
        mass_sigma_kg=float(sigma[0]),
        com_sigma_m=sigma[1:4],
        inertia_sigma_kg_m2=sigma[4:],
        physically_consistent=consistent,
    )
