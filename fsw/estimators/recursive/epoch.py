"""A new epoch: what some states were is over, and what the data said of the others stays.

Walks of integrated angles, so that a flight may be of any length: the steps of a walk reach over as
many windows as are stored. Beyond them, or behind a gap, the epoch ends: what the angle is off by
now becomes its zero, and new steps begin. Momentum: after a wrench from outside it is another one.
The data's information is carried over exactly: the states of the old epoch are eliminated by one
orthogonal factorisation. Source: Bierman, Factorization Methods for Discrete Sequential Estimation
(1977), ch. VI (elimination of variables that are not wanted any more).
"""

from dataclasses import dataclass

import numpy as np

from fsw.estimators.model.problem import Problem
from fsw.estimators.model.walks import LEAST_RAD2, Walks
from fsw.estimators.square_root import SquareRootInformation
from fsw.messages import FloatArray, IntArray


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
    into = np.zeros((len(old), p))
    into[:, zeros] = given[:, len(old) :]
    rhs = given @ np.r_[prior[0][old], mean[zeros]]
    return Epoch(mean, covariance, _eliminated(data, old, np.c_[given[:, : len(old)], into], rhs))


def next_momentum(
    problem: Problem,
    prior: tuple[FloatArray, FloatArray],
    data: SquareRootInformation,
    momentum_Nms: FloatArray,
) -> Epoch:
    """Return the epoch in which the momentum is another one, about momentum_Nms (3,), in N.

    Its sigma is the declared one and what it has changed by, together: where it was found from a
    rate, that rate is used again by the rows, with next to no weight here.

    Parameters
    ----------
    prior : mean (p,) and covariance (p, p) of the old epoch
    data : information of the old epoch's data alone
    """
    p = len(prior[0])
    own = np.arange(p)[problem.momentum]
    others = np.delete(np.arange(p), own)
    P = prior[1]
    K = np.linalg.solve(P[np.ix_(others, others)], P[np.ix_(others, own)]).T
    L = np.linalg.cholesky(P[np.ix_(own, own)] - K @ P[np.ix_(others, own)])
    given = np.zeros((len(own), len(own) + p))
    given[:, : len(own)] = np.linalg.solve(L, np.eye(len(own)))
    given[:, len(own) + others] = -np.linalg.solve(L, K)
    rhs = given @ np.r_[prior[0][own], prior[0]]
    mean, covariance = prior[0].copy(), P.copy()
    mean[own] = momentum_Nms
    declared = np.diag(problem.prior_covariance)[own]
    covariance[own], covariance[:, own] = 0.0, 0.0
    covariance[own, own] = declared + np.sum((momentum_Nms - prior[0][own]) ** 2)
    return Epoch(mean, covariance, _eliminated(data, own, given, rhs))


def _eliminated(
    data: SquareRootInformation, old: IntArray, given: FloatArray, rhs: FloatArray
) -> SquareRootInformation:
    """Return the data's information without the k `old` states.

    What is known of them beside the data are k rows `given` (k, k + p) on them and on all states of
    the new epoch, with right side rhs (k,).
    """
    p, size = len(data.z), len(old)
    rows = np.zeros((p + size, size + p + 1))
    rows[:p, :size], rows[:p, size:-1], rows[:p, -1] = data.R[:, old], data.R, data.z
    rows[:p, size + old] = 0.0
    rows[p:, :-1], rows[p:, -1] = given, rhs
    R = np.asarray(np.linalg.qr(rows, mode="r"), np.float64)[size:, size:]
    return SquareRootInformation(R[:p, :p].copy(), R[:p, p].copy())
