"""Sun and Moon from the Earth's centre (ERFA), their gravity, and the Earth's shadow."""

from collections.abc import Callable
from datetime import datetime
from typing import Any

import erfa
import numpy as np

from hil.world.environment.constants import AU_M, EARTH_RADIUS_M, MOON_GM_M3_S2, SUN_GM_M3_S2
from hil.world.environment.orbit import FloatArray

SECONDS_PER_DAY = 86400.0
NODE_S = 60.0  # between evaluations of the ephemerides


def epoch_tt(text: str) -> tuple[float, float]:
    """Return the two-part Julian date TT of a UTC time in ISO 8601.

    Raises
    ------
    ValueError if the text is not ISO 8601.
    """
    t = datetime.fromisoformat(text)
    seconds = t.second + 1e-6 * t.microsecond
    utc = erfa.dtf2d("UTC", t.year, t.month, t.day, t.hour, t.minute, seconds)
    tt: tuple[float, float] = erfa.taitt(*erfa.utctai(*utc))
    return tt


def sun_m(epoch: tuple[float, float], t_s: FloatArray) -> FloatArray:
    """Return the Sun's positions (k, 3) in N from the Earth's centre, t_s (k,) after the epoch."""
    return -_positions_m(lambda *tt: erfa.epv00(*tt)[0], epoch, t_s)


def moon_m(epoch: tuple[float, float], t_s: FloatArray) -> FloatArray:
    """Return the Moon's positions (k, 3) in N from the Earth's centre, t_s (k,) after the epoch."""
    return _positions_m(erfa.moon98, epoch, t_s)


def _positions_m(
    ephemeris: Callable[[float, FloatArray], Any], epoch: tuple[float, float], t_s: FloatArray
) -> FloatArray:
    """Return positions (k, 3), linear in time around each full minute; the error is below 3 m."""
    t = np.asarray(t_s, dtype=np.float64)
    nodes, own = np.unique(np.round(t / NODE_S), return_inverse=True)
    pv = ephemeris(epoch[0], epoch[1] + nodes * NODE_S / SECONDS_PER_DAY)
    after_days = (t - (nodes * NODE_S)[own]) / SECONDS_PER_DAY
    return np.asarray(AU_M * (pv["p"][own] + after_days[:, None] * pv["v"][own]))


def pull_m_s2(at_m: FloatArray, body_m: FloatArray, gm_m3_s2: float) -> FloatArray:
    """Return a body's gravity (k, 3) at `at_m` minus that at the Earth's centre."""
    to = body_m - at_m
    near = to / np.linalg.norm(to, axis=-1, keepdims=True) ** 3
    far = body_m / np.linalg.norm(body_m, axis=-1, keepdims=True) ** 3
    return np.asarray(gm_m3_s2 * (near - far))


def third_body_m_s2(at_m: FloatArray, epoch: tuple[float, float], t_s: FloatArray) -> FloatArray:
    """Return the acceleration (k, 3) by Sun and Moon relative to free fall about the Earth."""
    sun = pull_m_s2(at_m, sun_m(epoch, t_s), SUN_GM_M3_S2)
    return sun + pull_m_s2(at_m, moon_m(epoch, t_s), MOON_GM_M3_S2)


def is_lit(at_m: FloatArray, sun: FloatArray) -> FloatArray:
    """Return 1 in sunlight and 0 in the Earth's cylindrical shadow, shape (k,)."""
    s_hat = sun / np.linalg.norm(sun, axis=-1, keepdims=True)
    along = np.sum(at_m * s_hat, axis=-1)
    across = np.linalg.norm(at_m - along[..., None] * s_hat, axis=-1)
    return np.asarray(~((along < 0) & (across < EARTH_RADIUS_M)), dtype=np.float64)
