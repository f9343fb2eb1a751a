"""The density table against JB2006 itself, and JB2006 as wired here against Orekit's values."""

from datetime import UTC, datetime

import numpy as np
import pytest

from hil.world.environment import density
from hil.world.environment.density import density_kg_m3

PLACES = np.random.default_rng(8).uniform([300e3, -1.4, 0.0], [1000e3, 1.4, 6.28], (60, 3))


@pytest.fixture
def jb2006():
    pytest.importorskip("orekit_jpype", reason="needs the extra orekit")
    from hil.world.environment import jb2006

    return jb2006


def test_orekit_gives_its_legacy_values(jb2006):
    """2001-07-19 0 h, Sun at 90 and 20 deg; lat 45, lon 90 deg: 4.066e-12 and 9.451e-14 kg/m^3."""
    date = datetime(2001, 7, 19, tzinfo=UTC)  # TAI stands for UTC
    indices = (135.0, 95.0, 140.0, 100.0, 130.0, 95.0, 30.0)
    model = jb2006.Jb2006(indices, date, (np.radians(90.0), np.radians(20.0)))
    place = (np.radians(45.0), np.radians(90.0))
    assert model.at(400e3, *place) == pytest.approx(4.066e-12, rel=1e-3)
    assert model.at(660e3, *place) == pytest.approx(9.451e-14, rel=1e-3)


@pytest.mark.parametrize("activity", ["low", "moderate", "high"])
def test_the_table_is_jb2006_within_one_percent(jb2006, activity):
    """At random places between the table's points."""
    model = jb2006.Jb2006(jb2006.indices_of(activity))
    expected = np.array([model.at(*place) for place in PLACES.tolist()])
    found = density_kg_m3(PLACES[:, 0], PLACES[:, 1], PLACES[:, 2], activity)
    assert np.abs(found / expected - 1).max() < 0.01


def test_along_a_leo_track_table_and_orekit_agree(jb2006):
    """Same Sun, same day: only the interpolation is between them."""
    angle = np.linspace(0.0, 6.2, 12)
    place = 6_878_137.0 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    sun = np.broadcast_to([1.496e11, 0.0, 0.0], place.shape)
    table = density.along_track(place, sun, "moderate")
    direct = jb2006.along_track(place, sun, "moderate", jb2006.EPOCH)
    assert np.abs(table / direct - 1).max() < 0.01
