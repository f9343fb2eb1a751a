"""Residuals that drift slower than the blocks: what liquid in the base leaves behind."""

from dataclasses import replace

import numpy as np

from fsw.estimators.recursive.change import SLOW_BLOCKS, slow_power
from fsw.estimators.recursive.online import build_online
from hil.world.robot import Robot
from hil.world.spline import JointSpline
from hil.world.springs import SloshMass
from hil.world.truth import simulate
from tests.support.estimator_cases import (
    BASE,
    HIL,
    MOTION,
    URDF,
    WINDOW_S,
    draw_biases,
    make_config,
    noisy,
    parameters,
    robot_model,
    true_block,
)

ROWS, BLOCKS = 50, 140


def white(rng: np.random.Generator) -> np.ndarray:
    return rng.standard_normal((BLOCKS, ROWS))


def test_white_residuals_stay_below_the_limit() -> None:
    rng = np.random.default_rng(1)
    for _ in range(300):
        power, limit = slow_power(list(white(rng)), 1.0)
        assert power < limit


def test_a_slow_swing_of_a_third_of_the_noise_stands_out() -> None:
    """Expected power 1 + SLOW_BLOCKS times the swing's mean square, less what a sum smooths."""
    rng = np.random.default_rng(2)
    swing = np.sin(2 * np.pi * np.arange(BLOCKS) / 125.0)[:, None] * np.full(ROWS, 0.4)
    found = [slow_power(list(white(rng) + swing), 1.0) for _ in range(40)]
    assert sum(power > limit for power, limit in found) >= 39
    smoothed = np.sinc(SLOW_BLOCKS / 125.0) ** 2
    expected = 1 + SLOW_BLOCKS * smoothed * 0.4**2 * np.mean(
        np.sin(2 * np.pi * np.arange(128) / 125.0) ** 2
    )
    assert abs(np.mean([power for power, _ in found]) - expected) < 0.08  # 4 sigma of the mean


def test_loud_white_noise_is_no_drift_and_few_blocks_say_nothing() -> None:
    rng = np.random.default_rng(3)
    power, limit = slow_power(list(3.0 * white(rng)), 9.0)
    assert power < limit
    assert slow_power(list(white(rng))[: SLOW_BLOCKS - 1], 1.0) == (1.0, float("inf"))
    uneven = [r[:40] if k % 16 == 3 else r for k, r in enumerate(white(rng))]
    assert slow_power(uneven, 1.0) == (1.0, float("inf"))


def test_sloshing_liquid_does_not_end_as_a_confident_wrong_estimate() -> None:
    """50 kg of the base's 1000 swing at 0.02 Hz: within 3 sigma, or not valid."""
    tanks = [
        SloshMass(mass_kg=25.0, place_m=p, frequency_hz=0.02, damping_ratio=0.01, stroke_m=0.2)
        for p in ((0.855, -0.008, 0.041), (0.855, -0.808, 0.841))
    ]
    spline = JointSpline.load(HIL / "trajectories" / f"{MOTION['base']}.yaml")
    robot = Robot.load(URDF, "tool", base=BASE, slosh=tanks)
    history = simulate(robot, spline, 0.0, spline.duration_s, dt_s=0.01)
    rng = np.random.default_rng(7)
    biases = draw_biases(rng)
    online = build_online(make_config(("base",), target=None), robot_model())
    reasons = set()
    for k in range(int(spline.duration_s / WINDOW_S)):
        block = noisy(true_block(history, k * WINDOW_S, k), rng, biases)
        reasons.add(online.push(replace(block, index=k)).reason)
    last = online.finish()
    assert "MODEL_MISMATCH" in reasons
    error = np.abs(last.mean[:10] - parameters(BASE)) / np.sqrt(np.diag(last.covariance)[:10])
    assert not last.valid or error.max() < 3.0
