"""Conversion of states to what operators read: the bodies, and the whole robot in its pose."""

from dataclasses import replace

import numpy as np

from fsw.estimators.model.inertia import (
    from_parameters,
    is_consistent,
    nearest_consistent,
    report_jacobian,
)
from fsw.estimators.model.mobility import longer_sides
from fsw.estimators.model.problem import Problem
from fsw.messages import BodyEstimate, FloatArray


def body_estimate(
    problem: Problem, name: str, x: FloatArray, covariance: FloatArray
) -> tuple[BodyEstimate, float]:
    """Return the published body and the squared whitened distance of its projection.

    The published body is physically consistent. If the state's body is not, the nearest one in the
    covariance's metric replaces it, and `physically_consistent` is False; otherwise the distance is
    0. The sigma of a weakly known base is that of its longer side.
    """
    k = problem.body(name)
    pi, distance = x[k], 0.0
    consistent = is_consistent(pi)
    if not consistent:
        pi = nearest_consistent(pi, covariance[k, k])
        step = pi - x[k]
        distance = float(step @ np.linalg.solve(covariance[k, k], step))
    found = _report(pi, covariance[k, k], consistent)
    if name == "base" and consistent:
        J = report_jacobian(problem.prior_mean[k])
        prior_sigma = np.sqrt(np.diag(J @ problem.prior_covariance[k, k] @ J.T))
        sigma = longer_sides(pi, covariance[k, k], prior_sigma)
        found = replace(
            found,
            mass_sigma_kg=float(sigma[0]),
            com_sigma_m=sigma[1:4],
            inertia_sigma_kg_m2=sigma[4:],
        )
    return found, distance


def whole_estimate(
    problem: Problem, x: FloatArray, covariance: FloatArray, q_rad: FloatArray
) -> BodyEstimate:
    """Return mass, centre of mass and central inertia of the whole robot in B, at positions q.

    A de-orbit burn needs these. Their sigma includes the uncertainty of the known bodies.
    """
    C = problem.model.composite(q_rad)
    pi = C @ problem.pi(x)
    J = C @ problem.U
    k = problem.inertial
    return _report(pi, J @ covariance[k, k] @ J.T, is_consistent(pi))


def _report(pi: FloatArray, covariance: FloatArray, consistent: bool) -> BodyEstimate:
    mass, com, inertia = from_parameters(pi)
    J = report_jacobian(pi)
    sigma = np.sqrt(np.maximum(np.diag(J @ covariance @ J.T), 0.0))
    return BodyEstimate(
        mass_kg=mass,
        com_m=com,
        inertia_kg_m2=inertia,
        mass_sigma_kg=float(sigma[0]),
        com_sigma_m=sigma[1:4],
        inertia_sigma_kg_m2=sigma[4:],
        physically_consistent=consistent,
    )
