"""The offset between star tracker and gyro on a motion in closed form."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from offline.calibrate.time_offset import tracker_offset

SEEDS, SIGMAS = 60, 3.0
SIGMA_RAD = np.array([1e-5, 1e-5, 5e-5])
WALK = 4.4e-5
RATE_HZ, SOLUTIONS_HZ, DURATION_S = 250.0, 5.0, 40.0
AMPLITUDE = np.array([0.05, 0.03, 0.08])  # rad, about axes that stay nearly fixed
SPEED = np.array([1.1, 1.7, 0.8])  # rad/s


def angles(t_s: np.ndarray) -> np.ndarray:
    return AMPLITUDE * np.sin(SPEED * t_s[:, None])


def measured(rng: np.random.Generator, late_s: float, size: float = 1.0, skewed: float = 0.0):
    """Solutions that show the attitude `late_s` before their stamps, and the gyro's rates."""
    t_s = np.arange(0.0, DURATION_S, 1.0 / SOLUTIONS_HZ)
    fine_s = np.arange(-2.0, DURATION_S + 2.0, 1.0 / RATE_HZ)
    true = Rotation.from_rotvec(size * angles(fine_s))
    steps = (true[:-1].inv() * true[1:]).as_rotvec() * RATE_HZ
    gyro_s = 0.5 * (fine_s[:-1] + fine_s[1:])
    noise = WALK * RATE_HZ**0.5 * rng.standard_normal(steps.shape)
    turned = Rotation.from_rotvec([skewed, -skewed, skewed]).apply(steps)
    at = Rotation.from_rotvec(size * angles(t_s - late_s))
    at = at * Rotation.from_rotvec(SIGMA_RAD * rng.standard_normal((len(t_s), 3)))
    return t_s, at, gyro_s, turned + noise + [1e-4, -2e-4, 3e-4], SIGMA_RAD, WALK


@pytest.mark.parametrize("late_s", [0.0, 0.0123, -0.15])
def test_the_offset_is_within_its_sigma_with_a_bias_and_a_skewed_mounting(late_s):
    rng = np.random.default_rng(3)
    found = [tracker_offset(*measured(rng, late_s, skewed=0.01)) for _ in range(SEEDS)]
    off = np.array([(value - late_s) / sigma for value, sigma in found])
    assert np.abs(off).max() < SIGMAS + 0.5  # of 180 draws one in 20 sets is beyond 3.5
    assert 0.6 < np.sqrt(np.mean(off**2)) < 1.25  # a little too careful is allowed
    assert max(sigma for _, sigma in found) < 1e-3


def test_it_is_where_the_plain_correlation_of_the_rates_has_its_peak():
    rng = np.random.default_rng(4)
    late_s = 0.08
    t_s, at, gyro_s, rates, *noise = measured(rng, late_s)
    value, _ = tracker_offset(t_s, at, gyro_s, rates, *noise)
    turned = (at[:-1].inv() * at[1:]).as_rotvec()[:, 2] * SOLUTIONS_HZ
    middle_s = 0.5 * (t_s[:-1] + t_s[1:])
    trials = np.arange(-0.2, 0.2, 0.002)
    matches = [
        np.corrcoef(turned, np.interp(middle_s - d, gyro_s, rates[:, 2]))[0, 1] for d in trials
    ]
    assert value == pytest.approx(trials[np.argmax(matches)], abs=0.006)
    assert value == pytest.approx(late_s, abs=0.002)


@pytest.mark.parametrize("case", ["still", "beyond", "short"])
def test_no_offset_without_a_peak(case):
    rng = np.random.default_rng(5)
    size, late_s = {"still": (0.0, 0.0), "beyond": (1.0, 0.5), "short": (1.0, 0.0)}[case]
    t_s, at, gyro_s, rates, *noise = measured(rng, late_s, size)
    count = 8 if case == "short" else len(t_s)
    value, sigma = tracker_offset(t_s[:count], at[:count], gyro_s, rates, *noise)
    assert np.isnan(value)
    assert np.isinf(sigma)


def test_a_gap_of_the_gyro_moves_nothing():
    rng = np.random.default_rng(6)
    t_s, at, gyro_s, rates, *noise = measured(rng, 0.02)
    kept = (gyro_s < 15.0) | (gyro_s > 16.5)
    value, sigma = tracker_offset(t_s, at, gyro_s[kept], rates[kept], *noise)
    assert abs(value - 0.02) < SIGMAS * sigma < 2e-3
