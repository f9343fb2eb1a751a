"""Circular orbits against Kepler, WGS 84 and the almanac."""

from __future__ import annotations

import numpy as np
import pytest

from hil.environment.config import OrbitSection
from hil.environment.constants import AU_M
from hil.environment.orbit import Orbit
from hil.environment.sun_moon import epoch_tt, is_lit, moon_m, sun_m, third_body_m_s2

LEO = Orbit.from_section(OrbitSection(altitude_m=500e3))
GEO = Orbit.from_section(OrbitSection(altitude_m=35_786e3))
SIDEREAL_DAY_S = 86_164.1
MU = 3.986004418e14


def direction(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def test_geostationary_orbit_takes_a_sidereal_day():
    assert GEO.period_s == pytest.approx(SIDEREAL_DAY_S, rel=1e-4)


def test_gradient_and_speed_against_air_are_the_noted_ones():
    """3 mu/R^3 of LEO and GEO, and the speed against air turning with the Earth at 500 km."""
    assert 3 * LEO.rate_rad_s**2 == pytest.approx(3.675e-6, rel=1e-3)
    assert 3 * GEO.rate_rad_s**2 == pytest.approx(1.595e-8, rel=1e-3)
    assert np.linalg.norm(LEO.velocity_in_air_m_s(np.float64(0.0))) == pytest.approx(7111, rel=1e-3)


def test_any_circular_orbit_obeys_newton():
    orbit = Orbit.from_section(
        OrbitSection(
            altitude_m=700e3, inclination_rad=1.1, ascending_node_rad=2.0, latitude_argument_rad=0.7
        )
    )
    t, h = np.array([0.0, 1234.0]), 1.0
    p = orbit.position_m(t)
    second = (orbit.position_m(t + h) - 2 * p + orbit.position_m(t - h)) / h**2
    expected = -MU * p / np.linalg.norm(p, axis=1, keepdims=True) ** 3
    assert np.abs(second - expected).max() < 1e-5 * np.abs(expected).max()
    first = (orbit.position_m(t + h) - orbit.position_m(t - h)) / (2 * h)
    assert np.abs(first - orbit.velocity_m_s(t)).max() < 1e-2
    across = np.cross(p, orbit.velocity_m_s(t))
    assert direction(across)[0, 2] == pytest.approx(np.cos(1.1))


def test_sun_stands_at_the_vernal_point_at_the_equinox():
    """2013-03-20 11:02 UTC (Astronomical Almanac); a minute of arc is 24 minutes of time.

    The axes are those of J2000, against which the equinox of date has moved 0.19 deg along the
    ecliptic, most of it in right ascension.
    """
    sun = sun_m(epoch_tt("2013-03-20T11:02:00"), np.array([0.0]))[0]
    x, y, z = direction(sun)
    assert x > 0.999
    assert abs(np.degrees(np.arctan2(y, x))) < 0.25
    assert abs(np.degrees(z)) < 0.12
    assert np.linalg.norm(sun) == pytest.approx(0.996 * AU_M, rel=2e-3)


def test_moon_meets_sun_and_shadow_at_the_eclipses():
    """Annular eclipse of the Sun 2013-05-10 00:25, of the Moon 2013-04-25 20:08 UTC (NASA)."""
    new, full = epoch_tt("2013-05-10T00:25:00"), epoch_tt("2013-04-25T20:08:00")
    zero = np.array([0.0])
    meeting = direction(moon_m(new, zero)) @ direction(sun_m(new, zero)).T
    facing = direction(moon_m(full, zero)) @ direction(sun_m(full, zero)).T
    assert np.degrees(np.arccos(meeting))[0, 0] < 1.0  # parallax at most
    assert np.degrees(np.arccos(-facing))[0, 0] < 1.1


def test_third_body_pull_is_the_tidal_one():
    """mu_k/d^3 (3 s (s.r) - r), the first term of the expansion: within r/d ~ 2 % of the Moon's."""
    epoch = epoch_tt("2013-09-04T12:00:00")
    t = np.linspace(0.0, LEO.period_s, 9)
    place = LEO.position_m(t)
    expected = np.zeros_like(place)
    for body, mu in ((sun_m(epoch, t), 1.32712440018e20), (moon_m(epoch, t), 4.9028e12)):
        s, d = direction(body), np.linalg.norm(body, axis=1, keepdims=True)
        expected += mu / d**3 * (3 * s * np.sum(s * place, axis=1, keepdims=True) - place)
    pull = third_body_m_s2(place, epoch, t)
    assert np.abs(pull - expected).max() < 0.03 * np.abs(expected).max()


def test_third_body_force_has_the_noted_size():
    """About 1.8e-3 N in LEO and 1.1e-2 N in GEO on base and arm (1028 kg), at the most."""
    epoch = epoch_tt("2013-05-10T00:25:00")  # new moon: Sun and Moon pull together
    for orbit, force in ((LEO, 1.8e-3), (GEO, 1.1e-2)):
        t = np.linspace(0.0, orbit.period_s, 400)
        pull = 1028.0 * np.linalg.norm(third_body_m_s2(orbit.position_m(t), epoch, t), axis=1)
        assert pull.max() == pytest.approx(force, rel=0.2)


def test_shadow_covers_its_part_of_the_orbit():
    """Sun in the orbit's plane at 500 km: asin(R / (R + h)) / pi = 37.8 %."""
    t = np.linspace(0.0, LEO.period_s, 100_001)[:-1]
    sun = np.broadcast_to(AU_M * LEO.up_N, (len(t), 3))
    dark = 1.0 - is_lit(LEO.position_m(t), sun).mean()
    assert dark == pytest.approx(0.378, abs=5e-4)
    assert dark == pytest.approx(np.arcsin(6378.137 / 6878.137) / np.pi, abs=1e-4)
    assert is_lit(LEO.position_m(t), AU_M * np.array([[0.0, 0.0, 1.0]])).all()
