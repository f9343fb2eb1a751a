"""A new epoch: the same as the dense Gaussian, marginalised."""

import numpy as np
import pytest

from fsw.estimators.model.building import build_problem
from fsw.estimators.recursive.epoch import next_epoch, next_momentum
from fsw.estimators.square_root import SquareRootInformation
from tests.support.estimator_cases import N, make_config, robot_model
from tests.support.speed_cases import TURNING, speed_config


def test_nothing_is_lost_and_nothing_counted_twice() -> None:
    """Mean and covariance after the change agree with those of the dense transformation."""
    problem = build_problem(speed_config(np.zeros(N)), robot_model())
    walks, p = problem.walks, len(problem.names)
    assert walks is not None
    rng = np.random.default_rng(0)
    sigma = np.sqrt(np.diag(problem.prior_covariance))
    A = rng.normal(size=(25, p)) / sigma  # says less than there are states
    c = A @ (problem.prior_mean + sigma * rng.normal(size=p)) + rng.normal(size=25)
    data = SquareRootInformation(np.zeros((p, p)), np.zeros(p)).update(A, c)
    prior = SquareRootInformation.from_prior(problem.prior_mean, problem.prior_covariance)
    before = prior.update(data.R, data.z)
    walk = np.zeros(N)
    walk[list(TURNING)] = np.array([1.1, 0.55]) * walks.knots_rad2[:, -1]
    epoch = next_epoch(problem, walks, (problem.prior_mean, problem.prior_covariance), data, walk)
    after = SquareRootInformation.from_prior(epoch.mean, epoch.covariance).update(
        epoch.data.R, epoch.data.z
    )
    zeros = np.arange(p)[problem.at("joint_zero")][list(TURNING)]
    steps = np.arange(p)[problem.at("joint_walk")]
    T = np.eye(p)
    shares = walks.shares(walk[None])[0]
    for zero, own, share in zip(zeros, steps.reshape(2, -1), shares, strict=True):
        T[zero, own] = share
    T[steps] = 0.0
    covariance = T @ before.covariance() @ T.T
    covariance[np.ix_(steps, steps)] = problem.prior_covariance[np.ix_(steps, steps)]
    covariance[zeros, zeros] += walks.beside(walk[None])[0]
    scale = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose((after.mean() - T @ before.mean()) / scale, 0.0, atol=1e-6)
    np.testing.assert_allclose(
        after.covariance() / np.outer(scale, scale), covariance / np.outer(scale, scale), atol=1e-6
    )
    marginal = problem.prior_covariance[zeros, zeros] + walk[list(TURNING)]
    told = epoch.covariance[zeros, zeros]
    assert told[0] == pytest.approx(marginal[0], rel=1e-6)
    assert marginal[1] <= told[1] <= marginal[1] + walks.beside(walk[None])[0, 1]


def test_another_momentum_leaves_what_is_known_of_the_others() -> None:
    """Mean and covariance of the others are as before, whatever the prior told of both together."""
    problem = build_problem(make_config(momentum_sigma_nms=0.5), robot_model())
    p, own = len(problem.names), problem.at("momentum")
    others = np.delete(np.arange(p), own)
    rng = np.random.default_rng(1)
    sigma = np.sqrt(np.diag(problem.prior_covariance))
    root = np.eye(p) + 0.05 * rng.normal(size=(p, p))  # a prior that ties momentum to the others
    covariance = (root @ root.T) * np.outer(sigma, sigma)
    A = rng.normal(size=(25, p)) / sigma
    c = A @ (problem.prior_mean + sigma * rng.normal(size=p)) + rng.normal(size=25)
    data = SquareRootInformation(np.zeros((p, p)), np.zeros(p)).update(A, c)
    prior = (problem.prior_mean, covariance)
    before = SquareRootInformation.from_prior(*prior).update(data.R, data.z)
    momentum = problem.prior_mean[own] + np.array([3.0, -1.0, 2.0])
    epoch = next_momentum(problem, prior, data, momentum)
    after = SquareRootInformation.from_prior(epoch.mean, epoch.covariance).update(
        epoch.data.R, epoch.data.z
    )
    scale, k = sigma[others], np.ix_(others, others)
    step = (after.mean() - before.mean())[others]
    np.testing.assert_allclose(step / scale, 0.0, atol=1e-7)
    told, known = (each.covariance()[k] / np.outer(scale, scale) for each in (after, before))
    np.testing.assert_allclose(told, known, atol=1e-8)
    np.testing.assert_allclose(after.mean()[own], momentum, rtol=1e-9)
    assert (after.covariance()[own, own].diagonal() > 14.0).all()  # all of the change, declared too
