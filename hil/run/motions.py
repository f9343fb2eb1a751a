"""The motions of a scenario, checked against its robot."""

from pathlib import Path

import yaml

from hil.world.robot import Robot
from hil.world.scenario import Scenario, ScenarioError
from hil.world.spline import JointSpline, Motion
from hil.world.sudden import SuddenMotion


def motion(key: str, path: Path, robot: Robot) -> JointSpline:
    """Return a scenario's motion. Raises ScenarioError if it is invalid or has other joints."""
    try:
        spline = JointSpline.load(path)
    except (TypeError, ValueError, yaml.YAMLError) as error:
        words = " ".join(str(error).split())
        raise ScenarioError(f"trajectories.{key}: {path}: {words}") from error
    if spline.n != robot.n:
        raise ScenarioError(
            f"trajectories.{key}: {path}: a motion of {spline.n} joints; the robot has {robot.n}"
        )
    return spline


def motion_of(scenario: Scenario, robot: Robot) -> Motion:
    """Return the identification motion, with what is sudden in it.

    Raises
    ------
    ScenarioError if it is invalid or has other joints than the robot.
    """
    planned = motion("identification", scenario.identification, robot)
    return planned if scenario.sudden is None else SuddenMotion(planned, scenario.sudden)
