"""Circular orbits against Kepler, WGS 84 and the almanac."""

import erfa
import numpy as np
import pytest

from hil.world.environment.config import OrbitSection
from hil.world.environment.constants import AU_M
from hil.world.environment.orbit import Orbit
from hil.world.environment.sun_moon import epoch_tt, is_lit, moon_m, sun_m, third_body_m_s2

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


def test_positions_between_evaluations_are_those_of_the_ephemerides():
    epoch, t = epoch_tt("2013-09-05T11:36:00"), np.linspace(-7.0, 5000.0, 997)
    days = epoch[1] + t / 86400.0
    sun = -1.495978707e11 * erfa.epv00(epoch[0], days)[0]["p"]
    moon = 1.495978707e11 * erfa.moon98(epoch[0], days)["p"]
    assert np.abs(sun_m(epoch, t) - sun).max() < 5.0
    assert np.abs(moon_m(epoch, t) - moon).max() < 5.0


def test_moon_meets_sun_and_shadow_at_the_eclipses():
    """Annular eclipse of the Sun 2013-05-10 00:25, of the Moon 2013-04-25 20:08 UTC (NASA)."""
    new, full = epoch_tt("2013-05-10T00:25:00"), epoch_tt("2013-04-25T20:08:00")
    zero = np.array([0.0])
    meeting = direction(moon_m(new, zero)) @ direction(sun_m(new, zero)).T
    facing = direction(moon_m(full, zero)) @ direction(sun_m(full, zero)).T
    assert np.degrees(np.arccos(meeting))[0, 0] < 1.0  # parallax at most
    assert np.degrees(np.arccos(-facing))[0, 0] < 1.1


def test_third_body_pull_is_the_tidal_one():
    """The first two terms of the expansion in r/d; the next is (r/d)^2 = 3e-4 of the Moon's."""
    epoch = epoch_tt("2013-09-04T12:00:00")
    t = np.linspace(0.0, LEO.period_s, 9)
    place = LEO.position_m(t)
    expected = np.zeros_like(place)
    for body, mu in ((sun_m(epoch, t), 1.32712440018e20), (moon_m(epoch, t), 4.9028e12)):
        s, d = direction(body), np.linalg.norm(body, axis=1, keepdims=True)
        along = np.sum(s * place, axis=1, keepdims=True)
        square = np.sum(place**2, axis=1, keepdims=True)
        expected += mu / d**3 * (3 * s * along - place)
        expected += mu / d**4 * ((7.5 * along**2 - 1.5 * square) * s - 3.0 * along * place)
    pull = third_body_m_s2(place, epoch, t)
    assert np.abs(pull - expected).max() < 1e-3 * np.abs(expected).max()


def almanac_m(days: float) -> tuple[np.ndarray, np.ndarray]:
    """Sun and Moon (3,) from the Earth by the Astronomical Almanac's low-precision formulas.

    Good to 0.01 and 0.3 deg, 0.3 % of the Moon's distance; from the equinox of date, turned back to
    that of J2000 by the general precession in longitude, 1.397 deg a century. Days from J2000.
    """
    rad = np.radians
    T = days / 36525.0
    tilt, precession = rad(23.439 - 4e-7 * days), 1.397 * T

    def place(longitude: float, latitude: float, distance_m: float) -> np.ndarray:
        x, y, z = (
            np.cos(rad(latitude)) * np.cos(rad(longitude - precession)),
            np.cos(rad(latitude)) * np.sin(rad(longitude - precession)),
            np.sin(rad(latitude)),
        )
        across = y * np.cos(tilt) - z * np.sin(tilt), y * np.sin(tilt) + z * np.cos(tilt)
        return distance_m * np.array([x, *across])

    g = rad(357.528 + 0.9856003 * days)
    sun = place(
        280.460 + 0.9856474 * days + 1.915 * np.sin(g) + 0.020 * np.sin(2 * g),
        0.0,
        AU_M * (1.00014 - 0.01671 * np.cos(g) - 0.00014 * np.cos(2 * g)),
    )
    angles = [
        rad(a + b * T)
        for a, b in (
            (135.0, 477198.87), (259.3, -413335.36), (235.7, 890534.22), (269.9, 954397.74),
            (357.5, 35999.05), (186.5, 966404.03), (93.3, 483202.02), (228.2, 960400.89),
            (318.3, 6003.15), (217.6, -407332.21),
        )
    ]  # fmt: skip
    s = np.sin(angles)
    longitude = 218.32 + 481267.881 * T
    longitude += np.array([6.29, -1.27, 0.66, 0.21, -0.19, -0.11]) @ s[:6]
    latitude = float(np.array([5.13, 0.28, -0.28, -0.17]) @ s[6:])
    parallax = 0.9508 + np.array([0.0518, 0.0095, 0.0078, 0.0028]) @ np.cos(angles[:4])
    moon = place(longitude, latitude, 6_378_137.0 / np.sin(rad(parallax)))
    return sun, moon


@pytest.mark.parametrize("orbit", [LEO, GEO], ids=["LEO", "GEO"])
def test_third_body_pull_is_that_of_the_almanacs_sun_and_moon(orbit):
    """Within 1 % of the largest, at twelve epochs of a year, by Newton's law on other places."""
    worst, largest = 0.0, 0.0
    for month in range(1, 13):
        epoch = epoch_tt(f"2013-{month:02d}-09T06:00:00")
        days = epoch[0] - 2451545.0 + epoch[1]
        place = orbit.position_m(np.linspace(0.0, orbit.period_s, 7)[:-1])
        found = third_body_m_s2(place, epoch, np.zeros(6))
        expected = np.zeros_like(found)
        for body, mu in zip(almanac_m(days), (1.32712440018e20, 4.9028e12), strict=True):
            to = body - place
            expected += mu * to / np.linalg.norm(to, axis=1, keepdims=True) ** 3
            expected -= mu * body / np.linalg.norm(body) ** 3
        worst = max(worst, float(np.linalg.norm(found - expected, axis=1).max()))
        largest = max(largest, float(np.linalg.norm(expected, axis=1).max()))
    assert worst < 0.01 * largest


def test_third_body_force_has_the_noted_size():
    """About 1.8e-3 N in LEO and 1.1e-2 N in GEO on base and arm (1028 kg): two digits noted."""
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
