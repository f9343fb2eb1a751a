"""Diagnosis of a batch estimate against the bound of all sensors, with residuals and verdicts."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from fsw.estimators.diagnosis import diagnose, plain, whiteness
from fsw.estimators.measurement.mrnea import Rows
from fsw.estimators.model.problem import Problem
from fsw.messages import Block, BodyEstimate, FloatArray


def diagnose_batch(
    problem: Problem,
    fused: Collection[Rows],
    residuals: Sequence[FloatArray],
    blocks: Sequence[Block],
    mean: FloatArray,
    covariance: FloatArray,
    bodies: Mapping[str, BodyEstimate],
    level: float = 1.0,
    reasons: Sequence[str] = (),
) -> dict[str, Any] | None:
    """Return the diagnosis of a batch estimate as plain values; None without a proper covariance.

    `fused` are the rows of all sensors at the estimate, empty if they cannot be computed;
    `residuals` are the method's whitened residuals, block by block; the verdict names the
    `reasons` why the estimate is not valid.

    The Cramer-Rao bound is that of all sensors: the Fisher information of the fused rows at the
    estimate, for a noise variance `level` times the declared. So a method that does not use all
    sensors has an efficiency below one.
    """
    if not fused:
        return None
    try:
        fisher = np.asarray(sum(part.A.T @ part.A for part in fused)) / level
        R = problem.prior.at(mean).R
        precision = fisher + R.T @ R
        least = np.asarray(np.linalg.solve(precision, np.eye(len(mean))), np.float64)
        k = problem.published
        names = tuple(problem.names[i] for i in k)
        diagnosis = diagnose(
            names=names,
            prior_mean=problem.prior_mean[k],
            prior_covariance=problem.prior_covariance[np.ix_(k, k)],
            mean=mean[k],
            covariance=covariance[np.ix_(k, k)],
            bodies=dict(bodies),
            reasons=reasons,
            duration_s=int(blocks[-1].t_ns[-1] - blocks[0].t_ns[0]) * 1e-9,
            bound=least[np.ix_(k, k)],
        )
    except ValueError:  # LinAlgError: no proper covariance
        return None
    correlation, bound = whiteness(residuals)
    count, squares = sum(map(len, residuals)), sum(float(b @ b) for b in residuals)
    return {
        "innovation_lag1": {"correlation": correlation, "bound": bound},
        "noise_ratio": float(np.sqrt(squares / count)) if count else None,
        **plain(diagnosis, names),
    }
