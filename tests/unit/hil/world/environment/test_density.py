"""The density table against noted means, and its shape by day and height."""

import numpy as np
import pytest

from hil.world.environment import density
from hil.world.environment.density import density_kg_m3


@pytest.mark.parametrize(
    ("activity", "noted"), [("low", 4.9e-14), ("moderate", 8.2e-13), ("high", 3.0e-12)]
)
def test_global_mean_at_500_km_is_near_the_noted_one(activity, noted):
    """ECSS indices, annual mean; the table's day lies within the semi-annual wave of +-40 %."""
    rng = np.random.default_rng(2)
    latitude, hour = np.arcsin(rng.uniform(-1, 1, 4000)), rng.uniform(0, 2 * np.pi, 4000)
    mean = density_kg_m3(np.full(4000, 500e3), latitude, hour, activity).mean()
    assert mean == pytest.approx(noted, rel=0.4)


def test_the_day_side_is_denser_the_air_thins_and_ends():
    hours = np.linspace(0, 2 * np.pi, 49)
    ring = density_kg_m3(np.full(49, 500e3), np.zeros(49), hours, "moderate")
    bulge = hours[ring.argmax()]
    assert 0.2 < bulge < 1.0  # 13 h to 16 h local time
    assert ring[0] == pytest.approx(ring[-1], rel=1e-12)  # periodic
    heights = np.linspace(300e3, 1000e3, 50)
    column = density_kg_m3(heights, np.zeros(50), np.zeros(50), "high")
    assert np.all(np.diff(column) < 0)
    assert density_kg_m3(np.array([36e6]), np.zeros(1), np.zeros(1), "high") == 0.0
    with pytest.raises(ValueError, match="altitude_m"):
        density_kg_m3(np.array([250e3]), np.zeros(1), np.zeros(1), "low")
    assert "Orekit" in density.about()
