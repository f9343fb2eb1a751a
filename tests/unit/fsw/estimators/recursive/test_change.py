"""Judging innovations: one spike is gated, a run of them is a change, noise is neither."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.estimators.recursive.change import InnovationMonitor, colour, slow_power
from tests.support.estimator_cases import (
    noisy_blocks,
)
from tests.support.recursions import with_alarms

DOF = 52


def test_noise_raises_no_alarm_in_a_million_blocks() -> None:
    """The threshold promises 1e-10 per block for Gaussian excess; chi-square's tail is cut."""
    rng = np.random.default_rng(0)
    monitor = InnovationMonitor(1e-6)
    nis = rng.chisquare(DOF, 1_000_000)
    unit = np.zeros(DOF)
    alarms = 0
    for value in np.sqrt(nis):
        unit[0] = value
        alarms += monitor.judge(unit, armed=True).changed
    assert alarms == 0


@pytest.mark.parametrize("size", [20.0, 1e6])
def test_a_spike_is_rejected_and_no_change(size: float) -> None:
    rng = np.random.default_rng(1)
    monitor = InnovationMonitor(1e-6)
    for k in range(200):
        spike = k % 10 == 0
        judged = monitor.judge(rng.normal(size=DOF) + size * spike, armed=True)
        assert judged.accepted != spike
        assert not judged.changed


def test_three_in_a_row_are_a_change() -> None:
    rng = np.random.default_rng(1)
    monitor = InnovationMonitor(1e-6)
    assert [monitor.judge(rng.normal(size=DOF) + 9.0, armed=True).changed for _ in range(3)] == [
        False,
        False,
        True,
    ]


def test_white_innovations_are_called_white_and_others_not() -> None:
    rng = np.random.default_rng(2)
    white, drifting = InnovationMonitor(1e-6), InnovationMonitor(1e-6)
    slow = np.zeros(DOF)
    for _ in range(300):
        e = rng.normal(size=DOF)
        slow = 0.6 * slow + 0.8 * e
        white.judge(e, armed=True)
        drifting.judge(slow, armed=True)
    correlation, bound = white.whiteness()
    assert abs(correlation) < bound
    correlation, bound = drifting.whiteness()
    assert correlation > bound
    assert correlation == pytest.approx(0.6, abs=0.05)


def test_more_noise_than_declared_is_learned_and_less_is_not() -> None:
    rng = np.random.default_rng(3)
    monitor = InnovationMonitor(1e-6)
    for factor, expected in ((4.0, 4.0), (1.0, 1.0), (0.5, 1.0)):
        monitor.learn_level(factor * rng.chisquare(DOF, 64) / DOF, DOF, 20)
        assert monitor.level == pytest.approx(expected, rel=0.1)


def test_one_corrupt_block_is_gated_and_does_not_reopen() -> None:
    blocks = noisy_blocks("target", 5)
    blocks[60] = replace(blocks[60], tau_nm=blocks[60].tau_nm + 3.0)
    _, estimates, alarms = with_alarms(blocks)
    assert not alarms
    assert estimates[-1].gated == 1
    assert estimates[-1].valid


def test_a_first_block_without_an_edge_hides_no_slow_residual():
    """A constant of one sigma in 31 blocks of 66 rows, of which the first lacks the last 14."""
    rng = np.random.default_rng(4)
    blocks = [rng.standard_normal(66) + 1.0 for _ in range(31)]
    edges = [0] + [14] * 30
    blocks[0] = blocks[0][:52]
    found, limit = slow_power(blocks, 1.0, edges)
    assert found > 5.0 * limit
    assert colour(blocks, edges)[0] > 0.3
