"""Judging innovations: one spike is gated, a run of them is a change, noise is neither."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from fsw.estimators.recursive.change import InnovationMonitor
from fsw.estimators.recursive.online import OnlineEstimator, build_online
from fsw.messages import Block
from hil.world.spline import JointSpline
from hil.world.truth import Body, Robot, simulate
from tests.support.estimator_cases import (
    BASE,
    HIL,
    MOTION,
    TARGET,
    URDF,
    WINDOW_S,
    draw_biases,
    make_config,
    noisy,
    noisy_blocks,
    robot_model,
    true_block,
    true_blocks_cached,
)

DOF = 52
STEP_AT = 75  # block, in the middle of the motion
DELAY_BLOCKS = 5  # bound on the detection of a 5 % step of the target's mass


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


@lru_cache(maxsize=4)
def stepped_blocks(mass_ratio: float) -> tuple[Block, ...]:
    """Return clean blocks of the same joint motion whose target's mass and inertia step."""
    spline = JointSpline.load(HIL / "trajectories" / f"{MOTION['target']}.yaml")
    inertia = tuple(np.array(TARGET.inertia_kg_m2) * mass_ratio)
    target = Body(TARGET.mass_kg * mass_ratio, TARGET.com_m, inertia)
    robot = Robot.load(URDF, "tool", base=BASE, target=target)
    history = simulate(robot, spline, -3.0, spline.duration_s + 1.0, dt_s=0.01)
    before = true_blocks_cached("target", 59.9)
    after = [true_block(history, k * WINDOW_S, k) for k in range(STEP_AT, len(before))]
    return (*before[:STEP_AT], *after)


def run(blocks: list[Block], **options: object) -> tuple[OnlineEstimator, list, list[int]]:
    online = build_online(make_config(("target",), **options), robot_model())
    estimates, alarms = [], []
    for block in blocks:
        estimates.append(online.push(block))
        if any(code == "CHANGE_DETECTED" for _, code, _ in online.events()):
            alarms.append(block.index)
    return online, estimates, alarms


@pytest.mark.parametrize("method", ["fused", "mrnea", "rda"])
def test_a_step_of_the_mass_is_found_and_the_estimate_follows(method: str) -> None:
    """5 %: found within 5 blocks; invalid at once; right again by the end, within 4 sigma."""
    rng = np.random.default_rng(4)
    biases = draw_biases(rng)
    blocks = [noisy(b, rng, biases) for b in stepped_blocks(1.05)]
    online, estimates, alarms = run(blocks, method=method)
    assert len(alarms) == 1
    assert STEP_AT <= alarms[0] < STEP_AT + DELAY_BLOCKS
    assert estimates[STEP_AT - 1].valid
    at = estimates[alarms[0]]
    assert (at.valid, at.reason) == (False, "REOPENED")
    body = online.finish().bodies["target"]
    assert abs(body.mass_kg - 1.05 * TARGET.mass_kg) < 4 * body.mass_sigma_kg
    assert body.mass_sigma_kg < 0.02 * TARGET.mass_kg


def test_one_corrupt_block_is_gated_and_does_not_reopen() -> None:
    blocks = noisy_blocks("target", 5)
    blocks[60] = replace(blocks[60], tau_nm=blocks[60].tau_nm + 3.0)
    _, estimates, alarms = run(blocks)
    assert not alarms
    assert estimates[-1].gated == 1
    assert estimates[-1].valid


@pytest.mark.parametrize("method", ["fused", "mrnea", "rda"])
def test_nominal_runs_raise_no_alarm(method: str) -> None:
    """Four runs of 60 s each: no change, no conflict, no noise above the declared."""
    for seed in range(4):
        online = build_online(make_config(("target",), method=method), robot_model())
        for block in noisy_blocks("target", 100 + seed):
            online.push(block)
        assert online.events() == []


def test_noise_twice_the_declared_is_told_and_sigmas_follow() -> None:
    """All sensors at twice their noise: a noise ratio of 2, no change, sigmas twice as large."""
    rng = np.random.default_rng(6)
    biases = draw_biases(rng)
    blocks = []
    for k, b in enumerate(true_blocks_cached("target", 59.9)):
        names = ("cov_joint", "cov_tau", "cov_gyro", "cov_acc")
        louder = replace(b, index=k, **{name: 4.0 * getattr(b, name) for name in names})
        declared = {name: getattr(b, name) for name in names}
        blocks.append(replace(noisy(louder, rng, biases), **declared))
    online, _, alarms = run(blocks)
    assert not alarms
    last = online.finish()
    assert last.extra["noise_ratio"] == pytest.approx(2.0, abs=0.2)
    honest = run(noisy_blocks("target", 6))[0].finish()
    ratio = last.bodies["target"].mass_sigma_kg / honest.bodies["target"].mass_sigma_kg
    assert ratio == pytest.approx(2.0, rel=0.25)


def test_forgetting_without_end_changes_no_bit_and_a_finite_one_widens() -> None:
    blocks = noisy_blocks("target", 7, 30.0)
    never = run(blocks)[0].finish()
    endless = run(blocks, forgetting_time_s=1e30)[0].finish()
    assert np.array_equal(never.mean, endless.mean)
    assert np.array_equal(never.covariance, endless.covariance)
    short = run(blocks, forgetting_time_s=8.0)[0].finish()
    sigma = [e.bodies["target"].mass_sigma_kg for e in (never, short)]
    assert 1.2 * sigma[0] < sigma[1] < 10 * sigma[0]


def test_forgetting_is_the_same_in_retired_stored_and_running_information() -> None:
    """A store of 6 blocks and one of all: the same covariance within 5 % of each sigma."""
    blocks = noisy_blocks("target", 8, 30.0)
    few = run(blocks, forgetting_time_s=10.0, store_blocks=6)[0].finish()
    many = run(blocks, forgetting_time_s=10.0)[0].finish()
    ratio = np.sqrt(np.diag(few.covariance) / np.diag(many.covariance))
    assert np.all(np.abs(ratio - 1.0) < 0.05)
