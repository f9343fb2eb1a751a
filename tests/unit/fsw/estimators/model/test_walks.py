"""States of a walk: against interpolation, and against a simulated Wiener process."""

import numpy as np

from fsw.estimators.model.building import build_problem
from fsw.estimators.model.walks import STEPS, Walks, walks_of
from tests.support.estimator_cases import WINDOW_S, N, make_config, robot_model
from tests.support.speed_cases import DENSITY, TURNING, speed_config

KNOTS = np.array([[0.0, 1.0, 3.0, 4.0], [0.0, 0.5, 0.6, 9.0]])
WALKS = Walks(np.array(TURNING), KNOTS, 2.0)


def test_steps_add_up_to_a_line_between_knots() -> None:
    rng = np.random.default_rng(0)
    steps, walk = rng.normal(size=(2, 3)), np.zeros((50, N))
    walk[:, TURNING] = rng.uniform(0.0, 10.0, (50, 2))
    moved = WALKS.moved(steps.ravel(), walk)
    for j, k in enumerate(TURNING):
        at_knots = np.r_[0.0, np.cumsum(steps[j])]
        np.testing.assert_allclose(moved[:, k], np.interp(walk[:, k], KNOTS[j], at_knots))
    assert not np.delete(moved, TURNING, axis=1).any()


def test_steps_and_what_is_beside_them_make_a_wiener_process() -> None:
    """4000 walks: the variance of the walk less its steps is the one told, within 5 sigma."""
    rng, count = np.random.default_rng(1), 4000
    grid = np.linspace(0.0, 5.0, 501)
    path = np.c_[
        np.zeros(count), np.cumsum(rng.normal(size=(count, 500)) * np.sqrt(grid[1]), axis=1)
    ]
    at = np.searchsorted(grid, KNOTS[0] - 1e-9)
    left = path - np.array([np.interp(grid, KNOTS[0], own[at]) for own in path])
    walk = np.zeros((501, N))
    walk[:, TURNING[0]] = grid
    told = WALKS.beside(walk)[:, 0]
    assert np.abs(left.var(axis=0) - told).max() < 5.0 * told.max() * np.sqrt(2.0 / count)
    np.testing.assert_allclose(
        np.diff(path[:, at], axis=1).var(axis=0), WALKS.steps_rad2[0], rtol=0.1
    )


def test_blocks_of_a_step_are_told_the_noise_that_their_mean_has() -> None:
    """Bound: 10 % by the 40 blocks of the grid and 4000 bridges."""
    rng, count, blocks = np.random.default_rng(2), 4000, 40
    steps = rng.normal(size=(count, blocks)) / np.sqrt(blocks)
    path = np.c_[np.zeros(count), np.cumsum(steps, axis=1)]
    grid = np.arange(blocks + 1) / blocks
    bridges = (path - path[:, -1:] * grid)[:, :-1]
    walk = np.zeros((blocks, N))
    walk[:, TURNING[0]] = grid[:-1]
    told = Walks(np.array(TURNING[:1]), np.array([[0.0, 1.0]]), blocks).beside(walk)[:, 0]
    assert abs(told.sum() / blocks**2 / bridges.mean(axis=1).var() - 1.0) < 0.1


def test_the_store_decides_how_far_the_steps_reach() -> None:
    config = speed_config(np.zeros(N), store_blocks=100)
    walks = walks_of(config, tuple(range(N)))
    assert walks is not None
    np.testing.assert_allclose(walks.knots_rad2[:, -1], DENSITY * 100 * WINDOW_S, rtol=1e-6)
    problem = build_problem(config, robot_model())
    k = problem.at("joint_walk")
    assert k.stop - k.start == len(TURNING) * STEPS
    assert not set(range(k.start, k.stop)) & set(problem.published.tolist())
    np.testing.assert_allclose(
        np.diag(problem.prior_covariance)[k].reshape(2, -1).sum(axis=1), walks.knots_rad2[:, -1]
    )


def test_no_speed_only_joint_no_walk() -> None:
    problem = build_problem(make_config(), robot_model())
    assert problem.walks is None
    assert problem.at("joint_walk") == slice(0, 0)
