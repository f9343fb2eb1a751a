"""Conversion of state and covariance to the published estimate, for all recursive estimators."""

from dataclasses import replace

import numpy as np

from fsw.estimators.diagnosis import gains
from fsw.estimators.model.problem import Problem
from fsw.estimators.publish import body_estimate, whole_estimate
from fsw.estimators.reasons import Failed, is_displaced, reasons
from fsw.messages import Estimate, FloatArray

WEAKEST_GAIN = 0.5  # least information of data over prior, in any combination of body parameters


def weakest_gain(problem: Problem, prior: FloatArray, covariance: FloatArray) -> float:
    """Return the data's information over the prior's in the least known direction of the bodies."""
    k = np.ix_(problem.shown, problem.shown)
    return float(gains(prior[k], covariance[k])[0][0])


def outcome(
    problem: Problem,
    method: str,
    x: FloatArray,
    covariance: FloatArray,
    *,
    failed: Failed,
    t_ns: int,
    q_rad: FloatArray | None,
    blocks: int,
    gated: int,
    nis: float,
    nis_dof: int,
    condition_number: float,
    extra: dict[str, float],
    prior: FloatArray | None = None,
) -> Estimate:
    """Return the published estimate, with consistent bodies and the whole robot in its pose.

    Liquid in an unknown body widens the published covariance only, not the checks of excitation.

    Parameters
    ----------
    x, covariance : (p,) and (p, p), the whole state
    failed : failed checks so far; those of excitation and of possible bodies are added here
    q_rad : (n,) pose of the joints for the whole robot; None: without the whole robot
    gated : number of blocks left out
    prior : (p, p) covariance that the data started from; None: the problem's

    Raises
    ------
    numpy.linalg.LinAlgError if the covariance is not positive definite.
    """
    prior = problem.prior_covariance if prior is None else prior
    weak = weakest_gain(problem, prior, covariance) < WEAKEST_GAIN
    covariance = covariance + problem.liquid
    found = {name: body_estimate(problem, name, x, covariance) for name in problem.unknown}
    failed = replace(
        failed,
        not_excited=failed.not_excited or weak,
        displaced=is_displaced([distance for _, distance in found.values()]),
    )
    whole = None if q_rad is None else whole_estimate(problem, x, covariance, q_rad)
    k, shown = problem.bodies, problem.published
    gained = 0.5 * (
        np.linalg.slogdet(problem.prior_covariance[k, k])[1]
        - np.linalg.slogdet(covariance[k, k])[1]
    )
    return Estimate(
        t_ns=t_ns,
        reasons=reasons(failed),
        method=method,
        names=tuple(problem.names[i] for i in shown),
        mean=x[shown],
        covariance=covariance[np.ix_(shown, shown)],
        bodies={name: body for name, (body, _) in found.items()},
        blocks=blocks,
        gated=gated,
        nis=nis,
        nis_dof=nis_dof,
        condition_number=condition_number,
        information_gained_nats=float(gained),
        whole=whole,
        extra=extra,
    )
