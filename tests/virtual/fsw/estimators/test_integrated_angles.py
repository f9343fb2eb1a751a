"""Joints known by speed only, from samples without noise: target and start angles are found."""

from typing import Any

import numpy as np
import pytest

from fsw.config import Config
from fsw.estimators.batch.run import run_batch
from fsw.estimators.conditioning.blocks import Conditioner
from fsw.estimators.model.problem import Problem
from fsw.estimators.recursive.online import build_online
from fsw.messages import Block
from tests.support.estimator_cases import TARGET, WINDOW_S, N, motion, parameters, robot_model
from tests.support.speed_cases import START_SIGMA_RAD, TURNING, speed_config, speed_windows

STOP_S = 40.0
OFF_RAD = 1.5 * START_SIGMA_RAD  # of the angles that are told at the start


class NoNoise:
    """Draws zeros."""

    def normal(self, size: Any) -> np.ndarray:
        return np.zeros(size)


def blocks_without_noise(off_rad: float) -> tuple[Config, list[Block]]:
    """Return blocks of joints that begin so far off the angles that are told."""
    history = motion("target")
    config = speed_config(history.at(0.0).q + off_rad, biases=False)
    own = Conditioner(config, tuple(range(N)))
    windows = speed_windows(history, 0, 0.0, STOP_S, 0.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(np.random, "default_rng", lambda *_: NoNoise())
        blocks = [block for window in windows if (block := own.condition(window)) is not None]
    assert len(blocks) == round(STOP_S / WINDOW_S)
    return config, blocks


def solved(config: Config, blocks: list[Block], method: str) -> tuple[np.ndarray, np.ndarray]:
    """Return errors of the target and then of the angles at the start, and their sigmas."""
    found: list[np.ndarray] = []

    def keep(problem: Problem, mean: np.ndarray, covariance: np.ndarray, _: Any) -> None:
        states = np.arange(len(mean))
        zeros = states[problem.at("joint_zero")][list(TURNING)]
        k = np.r_[states[problem.body("target")], zeros]
        found.append(mean[k] - np.r_[parameters(TARGET), 0.0, 0.0])
        found.append(np.sqrt(np.diag(covariance))[k])

    run_batch(config, blocks, method, ["target"], keep=keep)
    return found[0], found[1]


@pytest.mark.parametrize("method", ["fused", "rda"])
def test_what_is_told_rightly_is_found_exactly(method):
    """Bound: truncation of the polynomials and the mean of the bridges, a twentieth of sigma."""
    error, sigma = solved(*blocks_without_noise(0.0), method)
    assert np.abs(error / sigma).max() < 0.05


def test_angles_that_are_told_wrongly_are_found():
    """The prior pulls by what it weighs: target within a sigma, angles nearer than they were."""
    error, sigma = solved(*blocks_without_noise(OFF_RAD), "fused")
    assert np.abs(error[:10] / sigma[:10]).max() < 1.0
    assert np.all(np.abs(error[10:] + OFF_RAD) < 0.5 * OFF_RAD)
    assert np.all(sigma[10:] < 0.7 * START_SIGMA_RAD)


def test_the_recursion_agrees_with_the_batch():
    config, blocks = blocks_without_noise(0.0)
    online = build_online(config, robot_model())
    for block in blocks:
        online.push(block)
    final = online.finish()
    error, sigma = solved(config, blocks, "fused")
    off = final.mean[:10] - parameters(TARGET) - error[:10]
    assert np.abs(off / sigma[:10]).max() < 0.05
    np.testing.assert_allclose(np.sqrt(np.diag(final.covariance))[:10], sigma[:10], rtol=0.03)
