"""Sensors that change slowly although they are declared exact: refused, or a sigma that says so."""

import pytest

from evidence.lies import EXACT
from evidence.lies.case import Flight, estimates_of, flight_of, judged
from evidence.lies.table import Lie
from hil.world.scenario import load

SCENARIO, SEED, RATE_HZ = "target_leo", 3, 500.0
LIES = {  # each was valid and up to 18 sigma wrong for tens of seconds
    "one gain": Lie(sensor="torque", kind="gain", size=1e-4, axis=0.2, onset_s=12.0),
    "all gains": Lie(sensor="torque", kind="gain", size=1e-4, axis=None, onset_s=12.0),
    "encoder": Lie(sensor="encoder", kind="drift", size=1e-4, axis=0.2, onset_s=12.0),
}
MOST_WRONG = 0.02  # of the valid outputs


@pytest.fixture(scope="module")
def flight() -> Flight:
    return flight_of(SCENARIO, EXACT, SEED)


@pytest.mark.parametrize("name", LIES)
def test_validity_falls_before_a_creeping_sensor_makes_the_estimate_wrong(
    flight: Flight, name: str
) -> None:
    found = estimates_of(flight.config, LIES[name].on(flight.clean), RATE_HZ)
    row = judged(found, flight.estimates, dict(load(SCENARIO).truth))
    assert row["harmful"]
    assert row["wrong"] <= MOST_WRONG * row["twin_valid"]
    assert "MODEL_MISMATCH" in found[-1].reasons


def test_the_same_flight_without_a_lie_stays_valid(flight: Flight) -> None:
    assert sum(one.valid for one in flight.estimates) >= len(flight.estimates) - 25
