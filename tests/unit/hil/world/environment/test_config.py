"""What an environment's section refuses, by key and value."""

import pytest
from pydantic import ValidationError

from hil.world.environment.config import EnvironmentSection
from hil.world.words import faults

ORBIT = {"altitude_m": 500e3}


@pytest.mark.parametrize(
    ("section", "named"),
    [
        ({"orbit": ORBIT | {"epoch_utc": "yesterday"}}, "orbit.epoch_utc"),
        ({"orbit": ORBIT | {"epoch_utc": "2013-02-30T00:00:00"}}, "orbit.epoch_utc"),
        ({"orbit": ORBIT | {"epoch_utc": "2013-02-03T00:00:00+02:00"}}, "without an offset"),
        ({"orbit": {"altitude_m": float("inf")}}, "orbit.altitude_m"),
        ({"orbit": ORBIT | {"inclination_rad": float("nan")}}, "orbit.inclination_rad"),
        ({"orbit": {"altitude_m": 1e5}, "atmosphere": {}}, "altitude_m 100000 is below"),
        ({"orbit": ORBIT, "surfaces": {"base": {"size_m": [1.0, -1.0, 1.0]}}}, "size_m"),
        ({"orbit": ORBIT, "attitude_xyzw": [0.0, 0.0, 0.0, 0.0]}, "attitude_xyzw"),
        ({"orbit": ORBIT, "atmosphere": {"density_kg_m3": float("inf")}}, "density_kg_m3"),
        (
            {"orbit": ORBIT, "solar_pressure": {"absorbed_ratio": 0.8, "mirrored_ratio": 0.8}},
            "must not exceed 1",
        ),
    ],
)
def test_what_is_wrong_is_named(section, named):
    with pytest.raises(ValidationError) as caught:
        EnvironmentSection.from_dict(section)
    text = faults(caught.value)
    assert named in text
    assert "\n" not in text


@pytest.mark.parametrize("epoch", ["2013-09-04T12:00:00", "2013-09-04T12:00:00Z"])
def test_what_is_right_is_taken(epoch):
    section = {"orbit": ORBIT | {"epoch_utc": epoch}, "atmosphere": {"density": "orekit"}}
    assert EnvironmentSection.from_dict(section).orbit.epoch_utc == epoch
