"""Air density by JB2006 at three levels of solar activity, from a table that comes with the bench.

The table holds the logarithm of the density over altitude, geodetic latitude and local solar time,
with the Sun on the equator; `python -m hil.world.environment.jb2006` makes it.
Cubic splines interpolate in the table.
"""

from functools import lru_cache
from pathlib import Path
from typing import Any

import erfa
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from hil.world.environment.config import TABLE_FROM_M, Activity
from hil.world.environment.orbit import FloatArray

TABLE = Path(__file__).parent / "jb2006.npz"
TURN = 2.0 * np.pi
ACTIVITIES: tuple[Activity, ...] = ("low", "moderate", "high")
WGS84 = 1  # ERFA's number of the ellipsoid
LOWEST_M, HIGHEST_M = TABLE_FROM_M, 1000e3  # here the table is within 1 % of JB2006
WRAP = 6  # local times repeated at either end, so that the spline is periodic


def density_kg_m3(
    altitude_m: FloatArray,
    latitude_rad: FloatArray,
    hour_angle_rad: FloatArray,
    activity: Activity,
) -> FloatArray:
    """Return densities (k,) [kg/m^3]; `hour_angle_rad` is right ascension minus the Sun's.

    Above the table the density is zero, because sunlight exceeds the air's force by far there.

    Raises
    ------
    ValueError for an altitude below the table.
    """
    table = _table()
    altitudes, latitudes = table["altitude_m"], table["latitude_rad"]
    if np.min(altitude_m) < LOWEST_M:
        raise ValueError(
            f"altitude_m {np.min(altitude_m):.0f} is below the density table's {LOWEST_M:.0f}; "
            "density: orekit has no such limit"
        )
    step = TURN / len(table["hour_angle_rad"])
    place = [
        (altitude_m - altitudes[0]) / (altitudes[1] - altitudes[0]),
        (latitude_rad - latitudes[0]) / (latitudes[1] - latitudes[0]),
        np.asarray(hour_angle_rad) % TURN / step + WRAP,
    ]
    log_density = map_coordinates(_periodic(activity), place, order=3, mode="nearest")
    return np.where(altitude_m > HIGHEST_M, 0.0, np.exp(log_density))


def along_track(positions_m: FloatArray, sun_m: FloatArray, activity: Activity) -> FloatArray:
    """Return the density (k,) [kg/m^3] at positions (k, 3) in N with the Sun at (k, 3) in N."""
    ascension, latitude, altitude = erfa.gc2gd(WGS84, positions_m)
    hour = ascension - np.arctan2(sun_m[:, 1], sun_m[:, 0])
    return density_kg_m3(altitude, latitude, hour, activity)


def about() -> str:
    """Return the text in the table about its origin."""
    return str(_table()["about"])


@lru_cache(maxsize=1)
def _table() -> dict[str, NDArray[Any]]:
    with np.load(TABLE) as stored:
        return dict(stored)


@lru_cache(maxsize=3)
def _periodic(activity: Activity) -> FloatArray:
    values = _table()["log_density"][ACTIVITIES.index(activity)].astype(np.float64)
    return np.concatenate([values[..., -WRAP:], values, values[..., :WRAP]], axis=-1)
