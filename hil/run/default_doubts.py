"""The bench's own configuration of a scenario, with the doubts that a user has by default."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hil.run.bench import robot_of
from hil.run.flight import flight_document, write_flight
from hil.run.motions import motion_of
from hil.world.prior import draw_prior
from hil.world.scenario import Scenario


def write_with_doubts(scenario: Scenario, seed: int, folder: Path) -> Path:
    """Write a configuration that declares nothing exact, and its robot; return its path.

    Links, gains and zeros of joints and the mounting of the inertial unit have the default doubts
    of the flight software. Priors and errors of declared effects are drawn as in a run without
    these doubts.

    Raises
    ------
    ScenarioError if the scenario's motion is invalid.
    """
    robot = robot_of(scenario)
    start_rad = motion_of(scenario, robot).evaluate(np.zeros(1))[0][0].tolist()
    priors = {body: draw_prior(scenario.truth[body], seed, body) for body in scenario.unknown}
    document = flight_document(
        scenario,
        priors,
        robot.joint_names,
        folder,
        scenario.bus_ports,
        {},
        start_rad=start_rad,
        seed=seed,
    )
    joints = [_doubted(joint) for joint in document["joints"]]
    devices = {key: _doubted(document[key]) for key in ("robot", "imu") if key in document}
    return write_flight(folder, scenario, priors, document | devices | {"joints": joints})


def _doubted(section: Mapping[str, object]) -> dict[str, object]:
    """Return a section without the sigmas that are declared zero."""
    return {k: v for k, v in section.items() if not ("_sigma_" in k and v == 0.0)}
