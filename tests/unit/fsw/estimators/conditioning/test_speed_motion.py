"""Speeds to angles: closed form, walk against Monte Carlo, gaps, restarts."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from fsw.estimators.conditioning.blocks import Conditioner
from fsw.messages import Block, Window
from fsw.messages.findings import Fault
from tests.support.estimator_cases import NODES, RATE_HZ, WINDOW_S, N, channel, motion
from tests.support.speed_cases import (
    DENSITY,
    SPEED_NOISE_RAD_S,
    TURNING,
    speed_config,
    speed_windows,
)

START = np.linspace(-1.0, 1.0, N)
A, W, B = 0.2, 0.9, 0.05  # of the speed A sin(W t) + B


def conditioner(noise_rad_s: float = SPEED_NOISE_RAD_S) -> Conditioner:
    return Conditioner(speed_config(START, noise_rad_s), tuple(range(N)))


def turning(rng: np.random.Generator, noise_rad_s: float, count: int) -> list[Window]:
    """Windows in which the joints that give speed turn by a closed form, and the others rest."""
    (like,) = speed_windows(motion("target"), 0, 0.0, WINDOW_S, 0.0)
    found = []
    for index in range(count):
        t = index * WINDOW_S + (np.arange(round(WINDOW_S * RATE_HZ)) + 0.5) / RATE_HZ
        joints = []
        for k in range(N):
            values = np.zeros((len(t), 2))
            if k in TURNING:
                values[:, 0] = A * np.sin(W * t) + B + noise_rad_s * rng.normal(size=len(t))
            joints.append(channel(t, values))
        start_ns = round(index * WINDOW_S * 1e9)
        found.append(
            replace(
                like,
                index=index,
                start_ns=start_ns,
                stop_ns=start_ns + round(WINDOW_S * 1e9),
                joints=tuple(joints),
            )
        )
    return found


def angle(t_s: np.ndarray) -> np.ndarray:
    return A / W * (1.0 - np.cos(W * t_s)) + B * t_s


def blocks_of(own: Conditioner, windows: list[Window]) -> list[Block]:
    blocks = [own.condition(window) for window in windows]
    return [block for block in blocks if block is not None]


def test_the_angle_is_the_integral_of_the_speed() -> None:
    """Bound: the polynomial leaves (W h)^6 of a speed within half a window h, below 1e-5 of it."""
    blocks = blocks_of(conditioner(), turning(np.random.default_rng(0), 0.0, 100))
    for block in blocks:
        t = block.t_ns * 1e-9
        for k in TURNING:
            assert np.abs(block.q_rad[:, k] - START[k] - angle(t)).max() < 1e-7
            assert np.abs(block.qd_rad_s[:, k] - A * np.sin(W * t) - B).max() < 1e-6
            assert np.abs(block.qdd_rad_s2[:, k] - A * W * np.cos(W * t)).max() < 1e-4


def test_the_walk_has_the_variance_of_integrated_white_noise() -> None:
    """The variance told is density times time; what the angles do agrees with it."""
    blocks = blocks_of(conditioner(), turning(np.random.default_rng(0), 0.0, 50))
    for block in blocks[1:]:
        expected = DENSITY * block.index * WINDOW_S
        assert block.walk_rad2[list(TURNING)] == pytest.approx(expected, rel=0.01)
        assert block.walk_rad2[0] == 0.0
    errors = []
    for seed in range(40):
        last = blocks_of(
            conditioner(), turning(np.random.default_rng(seed), SPEED_NOISE_RAD_S, 50)
        )[-1]
        before = last.q_rad[:, TURNING] - START[list(TURNING)] - angle(last.t_ns * 1e-9)[:, None]
        variance = last.walk_rad2[list(TURNING)] + last.cov_joint[list(TURNING), -NODES, -NODES]
        errors += (before[0] ** 2 / variance).tolist()
    low, high = chi2.ppf([0.0005, 0.9995], len(errors))
    assert low < sum(errors) < high


def test_noise_within_a_window_has_the_covariance_told() -> None:
    drawn = []
    for seed in range(300):
        (block,) = blocks_of(
            conditioner(), turning(np.random.default_rng(seed), SPEED_NOISE_RAD_S, 1)
        )
        k, t = TURNING[0], block.t_ns * 1e-9
        drawn.append(
            np.r_[
                block.qd_rad_s[:, k] - A * np.sin(W * t) - B,
                block.qdd_rad_s2[:, k] - A * W * np.cos(W * t),
                block.q_rad[:, k] - START[k] - angle(t),
            ]
        )
    covariance = block.cov_joint[k]
    values, vectors = np.linalg.eigh(covariance / np.outer(*2 * (np.sqrt(np.diag(covariance)),)))
    kept = values > 1e-6
    scaled = np.array(drawn) / np.sqrt(np.diag(covariance))
    white = scaled @ vectors[:, kept] / np.sqrt(values[kept])
    low, high = chi2.ppf([0.0005, 0.9995], white.size)
    assert low < np.sum(white**2) < high


def test_a_missing_window_is_bridged_and_widens_the_walk() -> None:
    windows = turning(np.random.default_rng(0), 0.0, 30)
    del windows[10]
    blocks = blocks_of(conditioner(), windows)
    k = TURNING[0]
    before, after = blocks[9], blocks[10]
    gained = after.walk_rad2[k] - before.walk_rad2[k]
    error = after.q_rad[:, k] - START[k] - angle(after.t_ns * 1e-9)
    assert gained > 2.0 * DENSITY * 2 * WINDOW_S
    assert np.abs(error).max() < 3.0 * np.sqrt(gained)


def test_a_long_gap_loses_the_angle_and_says_so() -> None:
    windows = turning(np.random.default_rng(0), 0.0, 30)
    own = conditioner()
    assert len(blocks_of(own, windows[:10])) == 10
    assert own.findings() == []
    assert blocks_of(own, windows[16:18]) == []
    found = own.findings()
    assert {finding.fault for finding in found} == {Fault.ENCODER_FAULT}
    assert {finding.subject for finding in found} == {f"joint{k + 1}" for k in TURNING}


def test_integration_goes_on_from_a_block_and_from_another_conditioner() -> None:
    """Bound: the motion's third derivative over the rest behind the last node, 2e-6 rad."""
    windows = turning(np.random.default_rng(0), 0.0, 30)
    whole = conditioner()
    blocks = blocks_of(whole, windows[:20])
    resumed, copied = conditioner(), conditioner()
    resumed.speeds.resume(blocks[-1], WINDOW_S)
    copied.speeds.take_over(whole.speeds)
    expected = blocks_of(whole, windows[20:])[-1]
    for other, bound in ((resumed, 5e-6), (copied, 0.0)):
        last = blocks_of(other, windows[20:])[-1]
        assert np.abs(last.q_rad - expected.q_rad).max() <= bound
        np.testing.assert_allclose(last.walk_rad2, expected.walk_rad2, rtol=1e-2)
