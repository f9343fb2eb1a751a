"""A new epoch of the walks of integrated angles, so that a flight may be of any length.

The steps of a walk reach over as many windows as are stored. Beyond them, or behind a gap, the
epoch ends: what the angle is off by now becomes its zero, and new steps begin. The data's
information is carried over exactly: by one orthogonal factorisation the zeros and steps of the old
epoch are eliminated, given the new zeros. Source: Bierman, Factorization Methods for Discrete
Sequential Estimation (1977), ch. VI (elimination of variables that are not wanted any more).
"""

from dataclasses import dataclass

import numpy as np

from fsw.estimators.model.problem import Problem
from fsw.estimators.model.walks import LEAST_RAD2, Walks
from fsw.estimators.square_root import SquareRootInformation
from fsw.messages import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Epoch:
    """What is known where an epoch begins: the prior of it, and what the data before have said."""

    mean: FloatArray  # (p,)
    covariance: FloatArray  # (p, p)
    data: SquareRootInformation


def next_epoch(
    problem: Problem,
    walks: Walks,
    prior: tuple[FloatArray, FloatArray],
    data: SquareRootInformation,
    walk_rad2: FloatArray,
) -> Epoch:
    """Return the epoch that begins where the walks of the old one have come to walk_rad2 (n,).

    Parameters
    ----------
    prior : mean (p,) and covariance (p, p) of the old epoch; zeros and steps independent of others
    data : information of the old epoch's data alone
    """
    p, count = len(prior[0]), len(walks.joints)
    zeros = np.arange(p)[problem.joint_zero][walks.joints]
    steps = np.arange(p)[problem.joint_walk]
    old = np.r_[zeros, steps]
    shares = walks.shares(walk_rad2[None])[0]  # (k, K)
    T = np.zeros((count, len(old)))
    T[:, :count] = np.eye(count)
    for j, row in enumerate(shares):
        T[j, count + j * len(row) : count + (j + 1) * len(row)] = row
    P, beside = prior[1][np.ix_(old, old)], walks.beside(walk_rad2[None])[0]
    spread = T @ P @ T.T + np.diag(np.maximum(beside, LEAST_RAD2))
    K = np.linalg.solve(spread, T @ P).T
    L = np.linalg.cholesky(P - K @ T @ P + LEAST_RAD2 * np.eye(len(old)))
    given = np.linalg.solve(L, np.c_[np.eye(len(old)), -K])
    mean, covariance = prior[0].copy(), prior[1].copy()
    mean[zeros], mean[steps] = T @ prior[0][old], problem.prior_mean[steps]
    covariance[old], covariance[:, old] = 0.0, 0.0
    covariance[np.ix_(steps, steps)] = problem.prior_covariance[np.ix_(steps, steps)]
    covariance[np.ix_(zeros, zeros)] = spread
    size = len(old)
    rows = np.zeros((p + size, size + p + 1))
    rows[:p, size:-1], rows[:p, -1] = data.R, data.z
    rows[:p, :size], rows[:p, size + old] = data.R[:, old], 0.0
    rows[p:, :size], rows[p:, size + zeros] = given[:, :size], given[:, size:]
    rows[p:, -1] = given @ np.r_[prior[0][old], mean[zeros]]
    R = np.asarray(np.linalg.qr(rows, mode="r"), np.float64)[size:, size:]
    return Epoch(mean, covariance, SquareRootInformation(R[:p, :p].copy(), R[:p, p].copy()))
