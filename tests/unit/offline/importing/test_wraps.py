"""Wraps of angles are found whatever speed limit the configuration states, and nothing else is."""

from math import pi, tau

import numpy as np
import pytest

from offline.importing.wraps import unwrap

T = np.arange(600) / 30.0
NOISE = np.array([1e-4])
PLACEHOLDERS = [0.05, 1.0, 3.0, 100.0, 1e9]  # the joint turns at up to 1.3 rad/s


def turning() -> np.ndarray:
    rng = np.random.default_rng(7)
    return 0.9 * T + 0.2 * np.sin(2 * T) + rng.normal(0, 1e-5, len(T))


def unwrapped(q: np.ndarray, limit: float, declared: bool | None = None, t: np.ndarray = T):
    values = q[:, None].copy()
    (count,) = unwrap(values, t, np.array([limit]), NOISE, [declared])
    return values[:, 0], count


@pytest.mark.parametrize("low", [-pi, 0.0, -3.0])
@pytest.mark.parametrize("limit", PLACEHOLDERS)
def test_a_turning_joint_is_unwrapped_under_any_speed_limit(limit, low):
    q = turning()
    wrapped = (q - low) % tau + low
    found, count = unwrapped(wrapped, limit)
    assert count == np.count_nonzero(np.abs(np.diff(wrapped)) > pi) > 0
    assert np.abs(np.diff(found - q)).max() < 1e-9


@pytest.mark.parametrize("limit", PLACEHOLDERS)
def test_a_joint_that_jitters_at_the_wrap_is_unwrapped(limit):
    rng = np.random.default_rng(8)
    q = pi + 1e-3 * np.sin(T) + rng.normal(0, 1e-4, len(T))
    wrapped = (q + pi) % tau - pi
    found, count = unwrapped(wrapped, limit)
    assert count > 10
    assert np.abs(np.diff(found - q)).max() < 1e-9


@pytest.mark.parametrize("limit", PLACEHOLDERS)
@pytest.mark.parametrize("jump", [0.5, 3.0, 4.5, 5.5, 7.2, 2 * tau, 100.0])
def test_a_jump_that_is_no_turn_stays(limit, jump):
    q = 0.2 * np.sin(T)
    q[300:] += jump
    found, count = unwrapped(q, limit)
    assert (count, (found == q).all()) == (0, True)


@pytest.mark.parametrize("limit", PLACEHOLDERS)
def test_a_plain_motion_however_fast_or_coarse_stays(limit):
    for speed, step in ((0.1, 1), (2.0, 1), (2.0, 30), (20.0, 1), (60.0, 1)):
        q = 3.0 * np.sin(speed * T[::step])
        found, count = unwrapped(q, limit, t=T[::step])
        assert (count, (found == q).all()) == (0, True)


def test_a_wrap_after_a_rest_is_found_with_a_true_speed_limit():
    q = pi - 0.03 + np.where(T > 15.0, np.minimum(0.9 * (T - 15.0), 0.06), 0.0)
    found, count = unwrapped((q + pi) % tau - pi, 1.0)
    assert count == 1
    assert np.abs(found - q).max() < 1e-9


def test_a_declared_wrap_needs_no_speed_and_a_refused_one_stays():
    q = np.cumsum(np.full(len(T), 2.5))  # nearly half a turn between samples
    wrapped = (q + pi) % tau - pi
    found, _ = unwrapped(wrapped, 1.0, declared=True)
    assert np.abs(np.diff(found - q)).max() < 1e-9
    assert (unwrapped(wrapped, 1.0, declared=False)[0] == wrapped).all()


def test_missing_values_and_stamps_stay_and_the_rest_is_unwrapped():
    q = turning()
    wrapped = (q + pi) % tau - pi
    wrapped[[50, 100, 101]] = np.nan
    t = T.copy()
    t[[200, 300]] = np.nan
    found, _ = unwrapped(wrapped, 1.0, t=t)
    assert np.isnan(found[[50, 100, 101]]).all()
    rows = np.isfinite(wrapped) & np.isfinite(t)
    assert np.abs(np.diff((found - q)[rows])).max() < 1e-9
    assert (found[[200, 300]] == wrapped[[200, 300]]).all()
