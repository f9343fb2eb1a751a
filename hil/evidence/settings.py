"""Settings of the command line, judged by scenario and flight software before anything is made."""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from hil.evidence.methods.flight_side import write_config
from hil.world.scenario import Scenario, ScenarioError, changed, load


def settled(name: str, settings: Sequence[str], seed: int) -> Scenario:
    """Return a scenario with settings KEY=VALUE that the flight software accepts as well.

    Raises
    ------
    ScenarioError naming the settings that are refused.
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
