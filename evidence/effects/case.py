"""One seed of a scenario: samples through the flight software's conditioner and recursion."""

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from evidence.effects.bound import error_squared
from evidence.effects.samples import exact, noisy, rate_hz
from evidence.methods.flight_side import priors_of, write_config
from evidence.methods.recursion import recursion_row
from evidence.methods.sensed import condition
from evidence.provenance import commit
from hil.judge.outcome import body_report, body_sigma
from hil.world.scenario import load, mapping_from


@dataclass(frozen=True, slots=True, order=True)
class Case:
    """A scenario and a seed, which fixes noise, biases, priors and errors of declared values."""

    scenario: str
    seed: int

    def __str__(self) -> str:
        """Return the key in the store."""
        return f"{self.scenario} {self.seed}"


def work(case: Case) -> dict[str, dict[str, Any]]:
    """Return the row of a case under its key."""
    scenario = load(case.scenario)
    priors = priors_of(scenario, case.seed)
    with TemporaryDirectory(prefix="effects-") as folder:
        config = write_config(scenario, case.seed, Path(folder))
        samples = noisy(exact(case.scenario, config), config, case.seed)
        row, final = recursion_row(
            config, condition(samples, config, rate_hz(scenario)), scenario.truth
        )
    reports = {body: body_report(final.bodies[body]) for body in scenario.unknown}
    error = np.concatenate([reports[body] - scenario.truth[body] for body in reports])
    return {
        str(case): row
        | {
            "scenario": case.scenario,
            "seed": case.seed,
            "error_over_bound_squared": error_squared(case.scenario, priors, error),
            "estimate": {body: mapping_from(report) for body, report in reports.items()},
            "sigma": {b: mapping_from(body_sigma(final.bodies[b])) for b in reports},
            "prior": {
                body: mapping_from(prior.report) | {"sigma": mapping_from(prior.sigma)}
                for body, prior in priors.items()
            },
            "commit": commit(),
        }
    }
