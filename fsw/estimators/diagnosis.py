"""How good an estimate is, in numbers and words: pure functions of prior, covariance and duration.

With P0 the prior's covariance, P the estimate's and F = P^-1 - P0^-1 what the data add, the
generalised eigenvectors of F against P0^-1 are the combinations of unknowns that the data determine
independently of each other; the eigenvalue (gain) is the data's information over the prior's.

Efficiency is the Cramer-Rao bound over the claimed covariance. It is one by construction for a
recursion that maximises the likelihood of its own channels (its factor is the root of the Fisher
information at its estimate). Against the bound of all channels it shows what a method wastes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.special import chdtri

from fsw.estimators.model.inertia import PARAMETERS, from_parameters, report_jacobian
from fsw.estimators.parameter_verdicts import MEASURED, Words, in_words, parameter_verdicts
from fsw.messages import BodyEstimate, FloatArray

DATA_GAIN = 1.0  # above it, the data determine the combination better than the prior did
CONFLICT_GAIN = 0.1  # combinations with a smaller gain cannot contradict the prior
CONFLICT_PROBABILITY = 1e-4
TERMS = 3  # unknowns named per combination
WHITE = 3.29  # two-sided 99.9 % of a standard normal
GOAL_RATIO = 0.01
Gaussian = tuple[FloatArray, FloatArray]  # mean (p,) and covariance (p, p)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Combination:
    """One generalised eigenvector: unknowns in units of their prior sigma, unit length."""

    gain: float
    source: str  # "data" or "prior"
    text: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Diagnosis:
    """How well the parameters are known, and from which source."""

    correlation: FloatArray  # (p, p)
    crb_sigma: FloatArray  # (p,) root of the bound's diagonal, prior included
    efficiency_trace: float  # tr(CRB P0^-1) / tr(P P0^-1); at most 1 for an honest covariance
    efficiency_volume: float  # (det CRB / det P)^(1/p)
    combinations: tuple[Combination, ...]  # weakest first
    known: int  # number of combinations known by data
    conflict: float  # squared whitened distance of data from prior
    conflict_limit: float  # its 99.99 % point
    verdicts: dict[str, str]  # a sentence per body
    parameters: dict[str, Words]  # per body: whether data or prior determine each parameter


def gains(prior_covariance: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return data-over-prior gains, ascending, and the whitening W (p, p) of their combinations.

    W (x - mean) has unit covariance under the prior and 1 / (1 + gain) under the estimate.

    Raises
    ------
    numpy.linalg.LinAlgError if the prior covariance is not positive definite.
    """
    L = np.linalg.cholesky(prior_covariance)
    half = np.linalg.solve(L, covariance)
    values, vectors = np.linalg.eigh(np.linalg.solve(L, half.T))
    shrink = np.clip(values[::-1], 1e-300, 1.0)
    W = np.linalg.solve(L.T, vectors[:, ::-1]).T
    return 1.0 / shrink - 1.0, W


def prior_conflict(
    prior_mean: FloatArray, prior_covariance: FloatArray, mean: FloatArray, covariance: FloatArray
) -> tuple[float, int]:
    """Return how far the data's own estimate is from the prior, squared and whitened, and its dof.

    With the step d, the data's information F and the prior's covariance P0 this is
    d^T (F^-1 + P0)^-1 d. It is computed by the step from the prior to the posterior, whose
    covariance is P0 - P if data and prior agree. Combinations of states with a gain of at most
    CONFLICT_GAIN do not count. Means are (p,), covariances (p, p).
    """
    gain, W = gains(prior_covariance, covariance)
    step = W @ (mean - prior_mean)
    use = gain > CONFLICT_GAIN
    return float(np.sum(step[use] ** 2 * (1.0 + 1.0 / gain[use]))), int(use.sum())


def stated_conflict(
    prior_mean: FloatArray,
    prior_covariance: FloatArray,
    mean: FloatArray,
    covariance: FloatArray,
    bodies: int,
) -> tuple[float, int]:
    """Return the smaller one of `prior_conflict` in moments and in the stated quantities.

    The first 10 x `bodies` states are the parameters of bodies.
    """
    starts = range(0, PARAMETERS * bodies, PARAMETERS)
    views = conflict_views((prior_mean, prior_covariance), (mean, covariance), starts)
    distances = [prior_conflict(*before, *after) for before, after in views]
    return min(distances, key=lambda found: found[0] / max(conflict_limit(found[1]), 1.0))


def conflict_views(
    prior: Gaussian, estimate: Gaussian, starts: range
) -> list[tuple[Gaussian, Gaussian]]:
    """Return prior and estimate in moments, and as stated; a true conflict shows in both.

    A prior is stated as a Gaussian of mass, centre of mass and central inertia. First and second
    moments are products of these, so an error of 50 % in each is many more sigmas in moments than
    in the stated quantities. The opposite holds for a body still badly known, whose centre of mass
    is a quotient. A body without positive mass is compared in moments only.

    Parameters
    ----------
    prior, estimate : mean (p,) and covariance (p, p)
    starts : first state of each body's ten
    """
    views = [(prior, estimate)]
    if min([estimate[0][k] for k in starts], default=1.0) > 0.0:
        views.append((as_stated(*prior, starts), as_stated(*estimate, starts)))
    return views


def as_stated(
    x: FloatArray, covariance: FloatArray, starts: range
) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance with mass, centre of mass, central inertia in place of moments."""
    y, J = x.copy(), np.eye(len(x))
    for start in starts:
        k = slice(start, start + PARAMETERS)
        mass, com, inertia = from_parameters(x[k])
        y[k] = np.concatenate([[mass], com, inertia])
        J[k, k] = report_jacobian(x[k])
    P = J @ covariance @ J.T
    return y, 0.5 * (P + P.T)


def conflict_limit(dof: int) -> float:
    """Return the distance that a correct prior exceeds once in ten thousand cases; 0 for dof 0."""
    return float(chdtri(dof, CONFLICT_PROBABILITY)) if dof else 0.0


def correlation_of(covariance: FloatArray) -> FloatArray:
    """Return the correlation matrix."""
    sigma = np.sqrt(np.diag(covariance))
    R: FloatArray = covariance / np.outer(sigma, sigma)
    return R


def diagnose(
    *,
    names: Sequence[str],
    prior_mean: FloatArray,
    prior_covariance: FloatArray,
    mean: FloatArray,
    covariance: FloatArray,
    bodies: dict[str, BodyEstimate],
    duration_s: float,
    bound: FloatArray | None = None,
    goal_ratio: float = GOAL_RATIO,
    reasons: Sequence[str] = (),
) -> Diagnosis:
    """Diagnose one estimate.

    Parameters
    ----------
    duration_s : length of the data since the prior [s]
    bound : (p, p) least covariance that all the data and the prior allow; None: the estimate's own,
        for which the efficiency is one
    goal_ratio : relative 1-sigma of the mass that the verdict is about
    reasons : why the estimate is invalid, for the verdict; empty: the estimate is valid

    Raises
    ------
    numpy.linalg.LinAlgError if the prior covariance is not positive definite.
    """
    p = len(names)
    gain, W = gains(prior_covariance, covariance)
    bound = covariance if bound is None else bound
    traces = [np.trace(np.linalg.solve(prior_covariance, P)) for P in (bound, covariance)]
    volumes = [np.linalg.slogdet(P)[1] for P in (bound, covariance)]
    distance, dof = stated_conflict(prior_mean, prior_covariance, mean, covariance, len(bodies))
    # row k of W acts on x; its loadings on the unknowns in prior sigmas are W P0 diag(1/sigma)
    loadings = W @ prior_covariance / np.sqrt(np.diag(prior_covariance))
    parameters = {
        name: parameter_verdicts(
            body, _stated_sigma(prior_mean[k], prior_covariance[k, k]), reasons
        )
        for name, body in bodies.items()
        for k in [_places(names, name)]
    }
    return Diagnosis(
        correlation=correlation_of(covariance),
        crb_sigma=np.sqrt(np.diag(bound)),
        efficiency_trace=float(traces[0] / traces[1]),
        efficiency_volume=float(np.exp((volumes[0] - volumes[1]) / p)),
        combinations=tuple(
            Combination(
                gain=float(g),
                source="data" if g > DATA_GAIN else "prior",
                text=_combination(names, row),
            )
            for g, row in zip(gain, loadings, strict=True)
        ),
        known=int(np.sum(gain > DATA_GAIN)),
        conflict=distance,
        conflict_limit=conflict_limit(dof),
        verdicts={
            name: _refusal(name, body, reasons, parameters[name])
            if reasons
            else verdict(
                name,
                body.mass_kg,
                float(np.sqrt(covariance[k, k])),
                float(np.sqrt(prior_covariance[k, k])),
                duration_s,
                goal_ratio,
            )
            for name, body in bodies.items()
            for k in [list(names).index(f"{name}.m")]
        },
        parameters=parameters,
    )


def _places(names: Sequence[str], body: str) -> slice:
    start = list(names).index(f"{body}.m")
    return slice(start, start + PARAMETERS)


def _stated_sigma(mean: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return 1 sigma (10,) of mass, centre of mass and central inertia."""
    J = report_jacobian(mean)
    return np.asarray(np.sqrt(np.maximum(np.diag(J @ covariance @ J.T), 0.0)), np.float64)


def _refusal(name: str, body: BodyEstimate, reasons: Sequence[str], words: Words) -> str:
    """Return the verdict on an invalid estimate; a measured mass is named as usable alone."""
    reason = ", ".join(reasons)
    if words["mass_kg"] != MEASURED:
        return f"{name} mass not identified: the estimate is not valid, {reason}"
    ratio = body.mass_sigma_kg / abs(body.mass_kg)
    return (
        f"{name} mass identified to +-{100 * ratio:.3g} % (1 sigma), of use alone: the estimate as "
        f"a whole is not valid, {reason} ({in_words(words)})"
    )


def verdict(
    body: str,
    mass_kg: float,
    sigma_kg: float,
    prior_sigma_kg: float,
    duration_s: float,
    goal_ratio: float = GOAL_RATIO,
) -> str:
    """Return a sentence on how well a body's mass is known and how much longer a goal needs.

    The data's information is assumed to continue growing at its mean rate so far.
    """
    ratio = sigma_kg / abs(mass_kg) if mass_kg else float("inf")
    rate = (sigma_kg**-2 - prior_sigma_kg**-2) / duration_s if duration_s > 0 else 0.0
    goal_kg = goal_ratio * abs(mass_kg)
    if rate * duration_s <= DATA_GAIN * prior_sigma_kg**-2:
        known = f"+-{100 * ratio:.3g} % (1 sigma)"
        return f"{body} mass not identified: the data add little to the prior, {known}"
    text = f"{body} mass identified to +-{100 * ratio:.3g} % (1 sigma)"
    if ratio <= goal_ratio:
        return f"{text}; the goal of {100 * goal_ratio:g} % is reached"
    needed_s = (goal_kg**-2 - sigma_kg**-2) / rate
    return f"{text}, needs {needed_s:.0f} s more of such motion for {100 * goal_ratio:g} %"


def whiteness(whitened: Sequence[FloatArray]) -> tuple[float, float]:
    """Return the lag-1 correlation of successive whitened residuals and its 99.9 % bound if white.

    Pairs of unequal length, where a channel was missing, are left out.
    """
    pairs = [(a, b) for a, b in pairwise(whitened) if len(a) == len(b) > 0]
    if not pairs:
        return 0.0, 1.0
    products = sum(float(a @ b) for a, b in pairs)
    power = sum(0.5 * float(a @ a + b @ b) for a, b in pairs)
    count = sum(len(a) for a, _ in pairs)
    return products / power if power else 0.0, min(1.0, WHITE / float(np.sqrt(count)))


def plain(diagnosis: Diagnosis, names: Sequence[str], strongest: int = 5) -> dict[str, Any]:
    """Return a diagnosis as plain JSON values, with the `strongest` largest correlations listed."""
    rows, columns = np.triu_indices(len(names), 1)
    values = diagnosis.correlation[rows, columns]
    order = np.argsort(-np.abs(values))[:strongest]
    return {
        "verdict": diagnosis.verdicts,
        "parameters": diagnosis.parameters,
        "names": list(names),
        "correlation": diagnosis.correlation.round(4).tolist(),
        "strongest_correlations": [
            {"between": [names[rows[i]], names[columns[i]]], "correlation": float(values[i])}
            for i in order
        ],
        "crb_sigma": diagnosis.crb_sigma.tolist(),
        "efficiency_trace": diagnosis.efficiency_trace,
        "efficiency_volume": diagnosis.efficiency_volume,
        "known_combinations": diagnosis.known,
        "combinations": [
            {"gain": c.gain, "known_by": c.source, "combination": c.text}
            for c in diagnosis.combinations
        ],
        "prior_conflict": {"distance": diagnosis.conflict, "limit": diagnosis.conflict_limit},
    }


def _combination(names: Sequence[str], row: FloatArray) -> str:
    order = np.argsort(-np.abs(row))[:TERMS]
    sign = np.sign(row[order[0]]) or 1.0
    return " ".join(f"{sign * row[i]:+.2f} {names[i]}" for i in order)
