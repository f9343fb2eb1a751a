"""Prediction of the information that a motion gives, by the estimator's own rows.

The planner's rows contain bodies, torque offsets and scales, biases and momentum. Here the motion
is sampled as the devices would, conditioned as in flight, and every state of the configuration is
included with its prior.
An orbit's gravity gradient and the model's noise count as well. Base rate and attitude are those of
zero momentum without firings; momentum and firings act through the predicted rows only.
"""

from collections.abc import Sequence

import numpy as np

from fsw.estimators.measurement.row_functions import row_function, stack
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.problem import Problem
from fsw.messages import Block, FloatArray
from planner import criteria
from planner.sampled import sampled_blocks
from planner.spline import Trajectory
from planner.subject import Subject


def foreseen_root(subject: Subject, trajectory: Trajectory) -> FloatArray:
    """Return R with R^T R the information after a motion from rest, prior included.

    The bodies' states come first; all others of the configuration follow.
    """
    return block_root(subject, foreseen_blocks(subject, trajectory))


def block_root(subject: Subject, blocks: Sequence[Block]) -> FloatArray:
    """Return the root R of the information R^T R of blocks and prior, at the nominal bodies."""
    problem, covariance = whole_problem(subject)
    p = len(subject.x)
    state = problem.prior_mean.copy()
    state[:p] = subject.x
    root = criteria.prior_root(covariance)
    for rows in stack(row_function("fused", "eiv", problem), blocks, state):
        root = criteria.triangular_root(np.vstack([root, rows.A]))
    return root


def whole_problem(subject: Subject) -> tuple[Problem, FloatArray]:
    """Return the estimation problem with all states of the configuration, and its prior covariance.

    The covariance of the unknown bodies is that of the subject.
    """
    problem = build_problem(subject.config, subject.model)
    covariance, p = problem.prior_covariance.copy(), len(subject.x)
    covariance[:p, :p] = subject.state_covariance[:p, :p]
    return problem, covariance


def foreseen_blocks(subject: Subject, trajectory: Trajectory) -> list[Block]:
    """Return the blocks of all whole windows of a motion, with the base's rate of zero momentum."""

    def signals(t_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        q, qd, qdd = (part.T for part in trajectory.evaluate(t_s)[:3])
        n, x = len(q), np.tile(subject.x[:, None], (1, len(t_s)))
        y = np.asarray(subject.kernel.signals(q, qd, qdd, x).full()).T
        return y[:, :n], y[:, n + 3 :], y[:, n : n + 3]

    return sampled_blocks(subject.config, subject.model, trajectory, signals)
