"""The file of a campaign, and the runs that the file describes."""

from __future__ import annotations

import hashlib
import json
from itertools import product
from pathlib import Path
from typing import Annotated, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from evidence.methods.cases import SENSOR_SETS
from hil.world.scenario import ScenarioError, load, read_yaml
from hil.world.spline import JointSpline
from hil.world.words import faults


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Seeds(_Section):
    """Consecutive seeds."""

    first: int = 0
    count: Annotated[int, Field(ge=1)]


class Campaign(_Section):
    """A campaign: every seed is combined with every scenario, noise and trajectory."""

    level: Literal["sample", "device"]
    seeds: Seeds
    scenarios: Annotated[tuple[str, ...], Field(min_length=1)]  # names or paths of files
    # sensor sets of the study of methods, by name; used at sample level only
    noises: Annotated[tuple[str, ...], Field(min_length=1)] = ("data sheet",)
    # null: the identification motion of the scenario
    trajectories: Annotated[tuple[Path | None, ...], Field(min_length=1)] = (None,)
    duration_s: Annotated[float, Field(gt=0)] | None = None  # null: the whole motion
    rate_hz: Annotated[float, Field(gt=0)] = 100.0  # rate of the samples; at sample level only

    def runs(self) -> list[CampaignRun]:
        """Return all runs, ordered by seed first."""
        seeds = range(self.seeds.first, self.seeds.first + self.seeds.count)
        return [
            CampaignRun(
                level=self.level,
                scenario=scenario,
                noise=noise,
                trajectory=trajectory,
                duration_s=self.duration_s,
                rate_hz=self.rate_hz,
                seed=seed,
            )
            for seed, scenario, noise, trajectory in product(
                seeds, self.scenarios, self.noises, self.trajectories
            )
        ]


class CampaignRun(_Section):
    """Everything that one run depends on, except the code."""

    level: Literal["sample", "device"]
    scenario: str
    noise: str
    trajectory: Path | None
    duration_s: float | None
    rate_hz: float
    seed: int

    @property
    def key(self) -> str:
        """Return the key of the run in the store."""
        text = json.dumps(self.model_dump(mode="json"), sort_keys=True)
        return f"{self.seed}-{hashlib.sha256(text.encode()).hexdigest()[:12]}"


def read(path: Path) -> Campaign:
    """Read the file of a campaign; paths in the file are relative to its folder.

    Raises
    ------
    ScenarioError naming file, key and invalid value.
    """
    try:
        campaign = Campaign.model_validate(read_yaml(path))
    except ValidationError as error:
        raise ScenarioError(f"{path}: {faults(error, Campaign)}") from error
    wrong = set(campaign.noises) - set(SENSOR_SETS)
    if wrong:
        raise ScenarioError(f"{path}: noises: {sorted(wrong)}; there are {list(SENSOR_SETS)}")
    if campaign.level == "device" and campaign.noises != ("data sheet",):
        raise ScenarioError(f"{path}: noises: at device level the scenario's sensors are used")
    home = path.parent
    scenarios = tuple(_placed(home, name) for name in campaign.scenarios)
    trajectories = tuple(
        None if place is None else (home / place).resolve() for place in campaign.trajectories
    )
    for name in scenarios:
        try:
            load(name)
        except ScenarioError as error:
            raise ScenarioError(f"{path}: scenarios: {error}") from error
    for place in trajectories:
        try:
            if place is not None:
                JointSpline.load(place)
        except (OSError, ValueError, yaml.YAMLError) as error:
            raise ScenarioError(f"{path}: trajectories: {' '.join(str(error).split())}") from error
    return campaign.model_copy(update={"scenarios": scenarios, "trajectories": trajectories})


def _placed(home: Path, name: str) -> str:
    """Return the name of a scenario, or the absolute path if the name is that of a file."""
    return str((home / name).resolve()) if name.endswith(".yaml") else name
