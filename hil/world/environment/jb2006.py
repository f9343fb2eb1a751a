"""Orekit's JB2006 (extra `orekit`): compute densities, or write the bench's table.

`python -m hil.world.environment.jb2006 [FILE.npz]` writes the table in a minute. No data files of
Orekit are needed: the time scale is TAI, the ellipsoid is at rest, the Sun's place is given.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from file_delivery.extras import needs
from hil.world.environment.config import Activity
from hil.world.environment.density import ACTIVITIES, TABLE
from hil.world.environment.orbit import FloatArray

if TYPE_CHECKING:
    from org.hipparchus.geometry.euclidean.threed import Vector3D

FLATTENING = 1.0 / 298.257223563  # WGS 84
EQUATOR_M = 6_378_137.0
EPOCH = datetime(2013, 3, 20, 12, tzinfo=UTC)  # read as TAI; the Sun is on the equator
# Long-term indices of ECSS-E-ST-10-04C for F10.7, S10.7, M10.7 (mean and day alike) and ap.
INDICES: Mapping[Activity, tuple[float, float, float, float]] = {
    "low": (65.0, 60.0, 60.0, 0.0),
    "moderate": (140.0, 125.0, 125.0, 15.0),
    "high": (250.0, 220.0, 220.0, 45.0),
}
ALTITUDES_M = np.arange(250e3, 1050.1e3, 25e3)
LATITUDES_RAD = np.radians(np.arange(-90.0, 90.1, 10.0))
HOURS_RAD = np.radians(np.arange(0.0, 359.9, 10.0))


class Jb2006:
    """The model for one set of indices: [F10, F10 mean, S10, S10 mean, M10, M10 mean, ap]."""

    def __init__(
        self,
        indices: Sequence[float],
        date: datetime = EPOCH,
        sun_rad: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Build the model; `date` is read as TAI, `sun_rad` is right ascension and declination."""
        started()
        from org.hipparchus.geometry.euclidean.threed import Vector3D
        from org.orekit.bodies import OneAxisEllipsoid
        from org.orekit.frames import FramesFactory
        from org.orekit.models.earth.atmosphere import JB2006
        from org.orekit.time import (
            AbsoluteDate,
            TimeScalesFactory,
        )

        tai = TimeScalesFactory.getTAI()
        self._frame = FramesFactory.getGCRF()
        self._earth = OneAxisEllipsoid(EQUATOR_M, FLATTENING, self._frame)
        day, clock = (date.year, date.month, date.day), (date.hour, date.minute, float(date.second))
        self._date = AbsoluteDate(*day, *clock, tai)
        sun = Vector3D(*sun_rad).scalarMultiply(1.496e11)
        inputs, light = _providers(indices, sun)
        self._model = JB2006(inputs, light, self._earth, tai)

    def at(self, altitude_m: float, latitude_rad: float, ascension_rad: float) -> float:
        """Return the density [kg/m^3] at a geodetic altitude, latitude and right ascension."""
        from org.orekit.bodies import GeodeticPoint

        place = self._earth.transform(GeodeticPoint(latitude_rad, ascension_rad, altitude_m))
        return float(self._model.getDensity(self._date, place, self._frame))

    def at_position(self, position_m: FloatArray) -> float:
        """Return the density [kg/m^3] at a position (3,) in N."""
        from org.hipparchus.geometry.euclidean.threed import Vector3D

        place = Vector3D(*(float(x) for x in position_m))
        return float(self._model.getDensity(self._date, place, self._frame))


def started() -> None:
    """Start the Java machine if it does not run yet.

    Raises
    ------
    ValueError if the extra is not installed.
    """
    try:
        jpype: Any = import_module("jpype")
        orekit_jpype: Any = import_module("orekit_jpype")
    except ImportError as error:
        raise ValueError(needs("density: orekit", str(error.name), "orekit")) from error
    if not jpype.isJVMStarted():
        orekit_jpype.initVM()


def indices_of(activity: Activity) -> tuple[float, ...]:
    """Return the seven indices for `Jb2006` at a level of solar activity."""
    f10, s10, m10, ap = INDICES[activity]
    return (f10, f10, s10, s10, m10, m10, ap)


def along_track(
    positions_m: FloatArray, sun_m: FloatArray, activity: Activity, date: datetime
) -> FloatArray:
    """Return the density (k,) at positions (k, 3) in N; the Sun stays at the first `sun_m`."""
    x, y, z = sun_m[0] / np.linalg.norm(sun_m[0])
    sun_rad = (float(np.arctan2(y, x)), float(np.arcsin(z)))
    model = Jb2006(indices_of(activity), date, sun_rad)
    return np.array([model.at_position(place) for place in positions_m])


def _providers(indices: Sequence[float], sun: Vector3D) -> tuple[Any, Any]:
    """Return the Java objects that give the model the indices and the Sun's place."""
    jpype: Any = import_module("jpype")
    JImplements, JOverride = jpype.JImplements, jpype.JOverride
    from org.hipparchus.geometry.euclidean.threed import Vector3D
    from org.orekit.time import AbsoluteDate
    from org.orekit.utils import TimeStampedPVCoordinates

    names = ("getF10", "getF10B", "getS10", "getS10B", "getXM10", "getXM10B", "getAp")
    body: dict[str, Any] = {
        "getMinDate": JOverride(lambda _self: AbsoluteDate.PAST_INFINITY),
        "getMaxDate": JOverride(lambda _self: AbsoluteDate.FUTURE_INFINITY),
    }
    for name, value in zip(names, indices, strict=True):
        body[name] = JOverride(lambda _self, _date, value=float(value): value)
    package = "org.orekit"
    inputs = JImplements(f"{package}.models.earth.atmosphere.JB2006InputParameters")(
        type("Indices", (), body)
    )
    light = JImplements(f"{package}.utils.ExtendedPositionProvider")(
        type(
            "Sun",
            (),
            {
                "getPosition": JOverride(lambda _self, *_where: sun),
                "getPVCoordinates": JOverride(
                    lambda _self, *where: TimeStampedPVCoordinates(where[0], sun, Vector3D.ZERO)
                ),
            },
        )
    )
    return inputs(), light()


def write(path: Path, altitudes_m: Iterable[float] = ALTITUDES_M) -> None:
    """Evaluate the model on the grid and write the table."""
    altitudes = np.array(list(altitudes_m))
    values = np.empty((len(ACTIVITIES), len(altitudes), len(LATITUDES_RAD), len(HOURS_RAD)))
    for level, activity in enumerate(ACTIVITIES):
        model = Jb2006(indices_of(activity))
        for index in np.ndindex(values.shape[1:]):
            place = (altitudes[index[0]], LATITUDES_RAD[index[1]], HOURS_RAD[index[2]])
            values[(level, *index)] = np.log(model.at(*(float(x) for x in place)))
    np.savez_compressed(
        path,
        altitude_m=altitudes,
        latitude_rad=LATITUDES_RAD,
        hour_angle_rad=HOURS_RAD,
        log_density=values.astype(np.float32),
        about=f"JB2006 of Orekit (orekit-jpype), {EPOCH:%Y-%m-%d %H h} TAI, Sun at "
        f"right ascension 0 and declination 0; F10.7, S10.7, M10.7, ap: {dict(INDICES)}",
    )


if __name__ == "__main__":
    write(Path(sys.argv[1]) if len(sys.argv) > 1 else TABLE)
