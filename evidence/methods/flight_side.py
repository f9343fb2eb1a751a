"""The flight software's side of one seed: its configuration and its estimation problem."""

import copy
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from fsw.config import BodyConfig, Config, load
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.problem import Problem
from fsw.estimators.model.robot import RobotModel
from hil.run.flight import flight_document, write_flight
from hil.world.prior import Prior, draw_prior
from hil.world.robot import Robot
from hil.world.scenario import Scenario


def priors_of(scenario: Scenario, seed: int, wider: float = 1.0) -> dict[str, Prior]:
    """Return the priors of the unknown bodies, wrong by 30-50 %, as `hil run` draws them.

    `wider` multiplies the sigma of the priors.
    """
    drawn = {body: draw_prior(scenario.truth[body], seed, body) for body in scenario.unknown}
    return {body: replace(prior, sigma=wider * prior.sigma) for body, prior in drawn.items()}


def write_config(scenario: Scenario, seed: int, folder: Path, wider: float = 1.0) -> Config:
    """Write the flight configuration of a seed into a folder; load and return it.

    `wider` multiplies the sigma of the loaded priors, because a file must not have so large sigmas.
    """
    config = _written(scenario, priors_of(scenario, seed), folder, seed)
    wide = {body: _doubted(config.bodies[body], wider) for body in scenario.unknown}
    return config.model_copy(update={"bodies": {**config.bodies, **wide}})


def write_true_config(scenario: Scenario, folder: Path) -> Config:
    """Write a configuration with true values and the usual sigmas; load and return it."""
    drawn = priors_of(scenario, 0)
    priors = {body: replace(p, report=scenario.truth[body]) for body, p in drawn.items()}
    return _written(scenario, priors, folder, None)


def _written(
    scenario: Scenario, priors: dict[str, Prior], folder: Path, seed: int | None
) -> Config:
    names = _joint_names(scenario.urdf, scenario.tool_frame)
    ports = scenario.bus_ports
    document = flight_document(scenario, priors, names, folder, ports, {}, seed=seed)
    return load(write_flight(folder, scenario, priors, document))


def _doubted(body: BodyConfig, wider: float) -> BodyConfig:
    """Return the body with its sigma multiplied by `wider`."""
    if body.sigma is None:
        return body
    com_m, inertia = (
        tuple(wider * v for v in own) for own in (body.sigma.com_m, body.sigma.inertia_kg_m2)
    )
    sigma = {"mass_kg": wider * body.sigma.mass_kg, "com_m": com_m, "inertia_kg_m2": inertia}
    return body.model_copy(update={"sigma": body.sigma.model_copy(update=sigma)})


def problem_of(config: Config) -> Problem:
    """Return the estimation problem of a configuration."""
    return build_problem(config, RobotModel(config.resolve(config.robot.urdf), "tool"), exact=True)


def without_biases(scenario: Scenario) -> Scenario:
    """Return the scenario without torque offsets and inertial biases: white noise remains."""
    sensors: dict[str, Any] = copy.deepcopy(scenario.sensors)
    sensors["joints"]["torque_offset_sigma_nm"] = 0.0
    sensors["imu"]["gyro_bias_sigma_rad_s"] = 0.0
    sensors["imu"]["acc_bias_sigma_m_s2"] = 0.0
    return replace(scenario, sensors=sensors)


@lru_cache(maxsize=4)
def _joint_names(urdf: Path, tool_frame: str) -> tuple[str, ...]:
    return Robot.load(urdf, tool_frame).joint_names
