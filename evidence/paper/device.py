"""The fused estimator at device level: plant and daemon in virtual time with the paper's noise."""

import tempfile
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from evidence.methods.exact import true_robot
from evidence.methods.flight_side import priors_of, write_config
from evidence.paper.cases import PaperUnit, scenario_of
from evidence.paper.identify import scored
from hil.run.bench import Setup, run_virtual, truth_of
from hil.run.progress import Quiet
from hil.world.history import TruthHistory
from hil.world.robot import Robot
from hil.world.scenario import FOLDER, Scenario
from hil.world.spline import JointSpline

# Angles with a noise of 3.2 mrad give accelerations only in long windows.
ESTIMATOR = {
    "window_s": 6.0,
    "nodes": 8,
    "settle_blocks": 5,
    "external_force_sigma_n": 0.01,
    "external_torque_sigma_nm": 0.01,
}


def run_device(unit: PaperUnit) -> dict[str, Any]:
    """Return the last estimate of the daemon in one run, under "fused", as JSON values."""
    scenario = _scenario(unit)
    robot, spline, history = _motion(unit.orbit, unit.system, unit.acting)
    with tempfile.TemporaryDirectory(prefix="study-") as name:
        folder = Path(name)
        setup = Setup(
            scenario=scenario,
            seed=unit.seed,
            folder=folder,
            config_path=folder / "flight.yaml",
            config=write_config(scenario, unit.seed, folder),
            priors=priors_of(scenario, unit.seed),
            robot=robot,
            spline=spline,
            history=history,
            bus_ports=scenario.bus_ports,
        )
        final = run_virtual(setup, Quiet(), record=False).final
    k = slice(0, 10 * len(scenario.unknown))
    covariance = np.array(final.covariance[k, k])
    found = scored(unit, final.x[k], covariance, final.reason or "OK")
    return {"fused": found | {"valid": final.valid}}


def _scenario(unit: PaperUnit) -> Scenario:
    scenario = scenario_of(unit.orbit, unit.system, unit.acting)
    path = FOLDER / "common" / "sensors_paper.yaml"
    flight = dict(scenario.flight)
    flight["estimator"] = dict(flight["estimator"]) | ESTIMATOR
    sensors = yaml.safe_load(path.read_text(encoding="utf-8"))
    return replace(scenario, sensors=sensors, flight=flight)


@lru_cache(maxsize=3)
def _motion(orbit: str, system: str, acting: str) -> tuple[Robot, JointSpline, TruthHistory]:
    scenario = scenario_of(orbit, system, acting)
    robot, spline = true_robot(scenario), JointSpline.load(scenario.identification)
    return robot, spline, truth_of(scenario, robot, spline)
