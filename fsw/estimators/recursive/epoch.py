"""A new epoch: some states begin again, and the data's information on the others is kept.

Random walks of integrated angles: epochs allow a flight of any length, while the steps of a walk
cover as many windows as are stored. After these steps, or after a gap, the epoch ends: the present
error of the angle becomes the joint's zero, and new steps begin. Momentum: after a wrench from
outside it has another value. The data's information is kept exactly: the states of the old epoch
are eliminated by one orthogonal factorisation. Source: Bierman, Factorization Methods for Discrete
Sequential Estimation (1977), ch. VI (elimination of variables that are not wanted any more).
"""

from dataclasses import dataclass

import numpy as np

from fsw.estimators.model.problem import Problem
from fsw.estimators.model.walks import LEAST_RAD2, Walks
from fsw.estimators.square_root import SquareRootInformation
from fsw.messages import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Epoch:
    """Prior of an epoch at its start, and the information of all data before it."""

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
    """Return the epoch that begins when the walks of the old one have the variance walk_rad2 (n,).

    Parameters
    ----------
    prior : mean (p,) and covariance (p, p) of the old epoch, in which the joints' zeros and the
        steps of the walks are independent of all other states
    data : information of the old epoch's data alone
    """
    p, count = len(prior[0]), len(walks.joints)
    zeros = np.arange(p)[problem.at("joint_zero")][walks.joints]
    steps = np.arange(p)[problem.at("joint_walk")]
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
    """Return the epoch in which the momentum has another value, about momentum_Nms (3,), in N.

    The prior's variance is the declared one plus the squared change. The rows use the rate again
    from which the momentum was found; with so large a variance this has almost no effect.

    Parameters
    ----------
    prior : mean (p,) and covariance (p, p) of the old epoch
    data : information of the old epoch's data alone
    """
    p = len(prior[0])
    own = np.arange(p)[problem.at("momentum")]
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

    The old prior on these states is given as k rows `given` (k, k + p) on them and on all states of
    the new epoch, with right side rhs (k,).
    """
    p, size = len(data.z), len(old)
    rows = np.zeros((p + size, size + p + 1))
    rows[:p, :size], rows[:p, size:-1], rows[:p, -1] = data.R[:, old], data.R, data.z
    rows[:p, size + old] = 0.0
    rows[p:, :-1], rows[p:, -1] = given, rhs
    R = np.asarray(np.linalg.qr(rows, mode="r"), np.float64)[size:, size:]
    return SquareRootInformation(R[:p, :p].copy(), R[:p, p].copy())
