"""Settings of the command line, checked by scenario and flight software before a run starts."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from pydantic import BaseModel

from evidence.methods.flight_side import write_config
from fsw.config import load as load_config
from hil.world.scenario import Scenario, ScenarioError, changed, load


def settled(name: str, settings: Sequence[str], seed: int) -> Scenario:
    """Return a scenario with its settings KEY=VALUE applied, which the flight software accepts too.

    Raises
    ------
    ScenarioError naming the settings that scenario or flight software rejects.
    """
    scenario = changed(load(name), settings)
    if not settings:
        return scenario
    with TemporaryDirectory(prefix="hil-") as folder:
        try:
            write_config(scenario, seed, Path(folder))
        except (OSError, ValueError) as error:
            words = " ".join(str(error).replace(f"{folder}/flight.yaml: ", "").split())
            named = [one for one in settings if one.partition("=")[0].split(".")[-1] in words]
            raise ScenarioError(f"--set {', '.join(named or settings)}: {words}") from error
    return scenario


def content_of(scenario: Scenario, configurations: Mapping[str, Path]) -> dict[str, str]:
    """Return hashes of what a world and configurations contain, their files included.

    Two runs with equal hashes have the same input, whatever the names of the files.
    """
    found = {"scenario": _hash(json.dumps(asdict(scenario), default=_plain).encode())}
    for name, path in configurations.items():
        config = load_config(path)
        robot = config.resolve(config.robot.urdf).read_bytes()
        found[name] = _hash(config.source + robot)
    return found


def _plain(value: object) -> object:
    """Return a value of a scenario for JSON; a file is its content."""
    if isinstance(value, Path):
        return _hash(value.read_bytes())
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    raise TypeError(f"{type(value).__name__} has no plain form")


def _hash(data: bytes) -> str:
    return sha256(data).hexdigest()
