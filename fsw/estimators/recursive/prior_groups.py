"""Which part of the prior the data contradict: group by group, and how far each may be widened.

A prior that is wrong and tight in one value hardly shows among fifty states, and one factor for all
states would widen sensors that agree with their data sheet. So each group is judged by its own
marginal and widened by its own factor: bodies and the forces on them as far as the data require;
sensors, known bodies and mounting to LARGEST times their stated sigma.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from fsw.estimators.diagnosis import Gaussian, conflict_views, prior_conflict
from fsw.estimators.model.inertia import PARAMETERS, report_jacobian
from fsw.estimators.model.problem import IndexArray, Problem
from fsw.estimators.model.state_groups import BY_NAME
from fsw.messages import FloatArray
from fsw.messages.false_alarms import per_test

GROUP_PROBABILITY = per_test("prior")  # of a conflict in one group of a correct prior
LARGEST = 3.0  # greatest factor on the stated sigma of a sensor, a known body or a mounting
_OF_BODY = (("mass", slice(0, 1)), ("centre of mass", slice(1, 4)), ("inertia", slice(4, 10)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Group:
    """States of one statement of the prior; for a body the stated quantities, not the moments."""

    name: str
    states: IndexArray
    most: float  # largest factor on the sigma in the problem's prior


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Widened:
    """A group that the data contradict, and the factor on its sigmas."""

    name: str
    sigmas: float  # rms distance of the data from the group's prior
    factor: float
    of_model: bool  # of a sensor, a known body or a mounting: the rest of the model is in doubt


def groups(problem: Problem) -> Iterator[Group]:
    """Yield the groups of a problem's states; each state is in one group."""
    for body in problem.unknown:
        start = problem.body(body).start
        for name, part in _OF_BODY:
            own = np.arange(start + part.start, start + part.stop)
            yield Group(name=f"{name} of {body}", states=own, most=np.inf)
    places: dict[str, list[int]] = {}
    for k in range(problem.bodies.stop, len(problem.names)):
        kind, _, which = problem.names[k].partition(".")
        place = which.rpartition(".")[0] if kind == "known" else kind
        places.setdefault(place, []).append(k)
    for place, states in places.items():
        group = BY_NAME.get(place)
        most = np.inf if group is not None and group.is_free else LARGEST
        yield Group(name=place, states=np.array(states), most=most)


def widen(
    problem: Problem,
    prior: Gaussian,
    estimate: Gaussian,
    *,
    bodies_first: bool = False,
) -> tuple[FloatArray, list[Widened]]:
    """Return the prior's covariance with contradicted groups widened, and these groups.

    A group that is already as wide as allowed has the factor 1. With `bodies_first`, sensors, known
    bodies and mountings are left as they are while a body's prior is wrong, which biases them too.

    Parameters
    ----------
    prior, estimate : mean (p,) and covariance (p, p)

    Raises
    ------
    numpy.linalg.LinAlgError if a covariance is not positive definite.
    """
    bodies = range(0, problem.bodies.stop, PARAMETERS)
    views = conflict_views(prior, estimate, bodies)
    stated_sigma = np.sqrt(np.diag(problem.prior_covariance))
    sigma, scale = np.sqrt(np.diag(prior[1])), np.ones(len(prior[0]))
    found: list[Widened] = []
    for group in groups(problem):
        k, of_model = group.states, bool(np.isfinite(group.most))
        if bodies_first and of_model and any(not other.of_model for other in found):
            continue
        ratio, size = min(_distance(before, after, k) for before, after in views)
        if ratio <= 1.0:
            continue
        left = group.most * float(np.min(stated_sigma[k] / sigma[k]))
        factor = max(1.0, min(size, left))
        scale[k] = factor
        found.append(Widened(name=group.name, sigmas=size, factor=factor, of_model=of_model))
    return _scaled(prior, scale, bodies), found


def in_words(found: Sequence[Widened]) -> str:
    """Return which groups of the prior the data contradict; empty: none."""
    words = [
        f"{_quantity(group.name)} lies {group.sigmas:.1f} sigma (rms) from what is configured, "
        f"whose sigma counts {group.factor:.1f} times as wide"
        for group in found
    ]
    keys = dict.fromkeys(BY_NAME[own.name].key for own in found if own.name in BY_NAME)
    cure = "correct the value, or state a wider sigma" + f" ({', '.join(keys)})" * bool(keys)
    return f"the data contradict the prior: {'; '.join(words)}; {cure}" if words else ""


def _quantity(name: str) -> str:
    """Return a group's name in words; the states of a known body or link have its name."""
    if name in BY_NAME:
        return BY_NAME[name].cause or BY_NAME[name].effect
    return name if " of " in name else f"inertial data of {name}"


def _distance(prior: Gaussian, estimate: Gaussian, k: IndexArray) -> tuple[float, float]:
    """Return the squared distance in states k over its limit, and its rms in sigmas."""
    own = np.ix_(k, k)
    squared, dof = prior_conflict(prior[0][k], prior[1][own], estimate[0][k], estimate[1][own])
    if dof == 0:
        return 0.0, 0.0
    return squared / float(chdtri(dof, GROUP_PROBABILITY)), float(np.sqrt(squared / dof))


def _scaled(prior: Gaussian, scale: FloatArray, bodies: range) -> FloatArray:
    """Return the covariance with scaled sigmas; for bodies the sigmas of stated quantities."""
    mean, covariance = prior
    A = np.diag(scale)
    for start in bodies:
        k = slice(start, start + PARAMETERS)
        J = report_jacobian(mean[k])
        A[k, k] = np.linalg.solve(J, A[k, k] @ J)
    widened = A @ covariance @ A.T
    return np.asarray(0.5 * (widened + widened.T), np.float64)
