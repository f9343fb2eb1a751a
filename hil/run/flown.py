"""Blocks of one run in virtual time, from plant, devices and daemon, without a recording.

Measurements use these blocks, so that they need no recording from the user.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fsw.config import Config
from fsw.estimators.model.robot import RobotModel
from fsw.messages import Block
from hil.run.bench import prepare, run_virtual
from hil.run.progress import Quiet
from hil.world.scenario import load


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Flown:
    """Output of a run: robot and blocks are in memory, the run's folder is deleted."""

    config: Config
    model: RobotModel
    blocks: Sequence[Block]


def fly(scenario: str, seed: int) -> Flown:
    """Simulate a scenario in virtual time; the blocks depend only on scenario and seed."""
    with tempfile.TemporaryDirectory(prefix="hil-") as folder:
        setup = prepare(load(scenario), seed, Path(folder))
        recorded = run_virtual(setup, Quiet(), record=False)
        robot = setup.config.robot
        model = RobotModel(setup.config.resolve(robot.urdf), robot.tool_frame)
    return Flown(config=setup.config, model=model, blocks=recorded.blocks)


def with_estimator(config: Config, method: str, weighting: str = "eiv") -> Config:
    """Return the configuration with another online estimator."""
    chosen = config.estimator.model_copy(update={"method": method, "weighting": weighting})
    return config.model_copy(update={"estimator": chosen})
