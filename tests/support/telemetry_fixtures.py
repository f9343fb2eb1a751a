from collections.abc import Iterator

import pytest

from tests.conftest import ArmProject
from tests.support.application_cases import Flight, flight_config


@pytest.fixture
def flight(arm: ArmProject) -> Iterator[Flight]:
    """A daemon that is identifying."""
    flight = Flight(flight_config(arm))
    flight.up()
    yield flight
    flight.app.close()
