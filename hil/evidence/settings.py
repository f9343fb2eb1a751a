"""Settings of the command line, checked by scenario and flight software before a run starts."""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from hil.evidence.methods.flight_side import write_config
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
