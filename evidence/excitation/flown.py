"""Compare the runs of `hil seeds NAME --out DIR` with the planner's prediction for their motion.

The prediction includes every state and is made at the true bodies. So it is the Cramer-Rao bound
of the sensors and uncertainties that the configuration declares.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from fsw.config import Config
from fsw.estimators.model.inertia import report_jacobian, to_parameters
from hil.run import bench
from hil.world.inertia import FloatArray
from hil.world.scenario import Scenario, changed, load
from planner import criteria, spline
from planner.firings import Firing
from planner.foreseen import foreseen_root
from planner.subject import build_subject


@dataclass(frozen=True, slots=True, kw_only=True)
class Flights:
    """Sigmas and errors of the seeds of a scenario, in units of the prediction."""

    name: str  # of the scenario
    seeds: int
    sigma: tuple[float, float]  # least and largest published over predicted sigma
    error: float  # root mean square error, whitened by the predicted covariance
    interval: tuple[float, float]  # 95 % bootstrap interval of the error over the seeds


def flights(folder: Path) -> Flights:
    """Return the judgement of the outcomes in a folder of `hil seeds`."""
    settings = json.loads((folder / "settings.json").read_text(encoding="utf-8"))
    lines = (folder / "results.jsonl").read_text(encoding="utf-8").splitlines()
    outcomes: list[dict[str, Any]] = [json.loads(line)[1] for line in lines]
    words = settings["options"]
    sets = [words[k + 1] for k, word in enumerate(words) if word == "--set"]
    scenario = changed(load(settings["scenario"]), sets)
    with TemporaryDirectory(prefix="hil-") as place:
        setup = bench.prepare(scenario, outcomes[0]["seed"], Path(place))
        C = predicted(setup.config, setup.scenario)
    root = np.linalg.cholesky(C)
    errors = [stacked(o["estimate"]) - stacked(o["truth"]) for o in outcomes]
    shares = [ratios(o["sigma"], C) for o in outcomes]
    white = np.linalg.solve(root, np.transpose(errors))
    squares = np.mean(white**2, axis=0)
    draws = np.random.default_rng(0).choice(squares, (20_000, len(squares)))
    low, high = np.percentile(np.sqrt(draws.mean(axis=1)), (2.5, 97.5))
    return Flights(
        name=settings["scenario"],
        seeds=len(outcomes),
        sigma=(float(np.min(shares)), float(np.max(shares))),
        error=float(np.sqrt(np.mean(squares))),
        interval=(float(low), float(high)),
    )


def predicted(config: Config, scenario: Scenario) -> FloatArray:
    """Return the predicted covariance (p, p) of the reported quantities, at the true bodies."""
    own = build_subject(config)
    reports = [scenario.truth[body] for body in own.problem.unknown]
    x = np.concatenate([to_parameters(r[0], r[1:4], r[4:]) for r in reports])
    T = np.zeros((len(x), len(x)))
    for body in own.problem.unknown:
        k = own.problem.body(body)
        T[k, k] = report_jacobian(x[k])
    motion = replace(spline.load(scenario.identification), firings=_firings(config, scenario))
    whole = np.concatenate([x, own.problem.prior_mean[len(x) :]])
    known = own.problem.prior.at(whole).covariance()
    own = replace(own, x=x, state_covariance=known, scale=replace(own.scale, T=T))
    return criteria.report_covariance(foreseen_root(own, motion), own.scale)


def ratios(sigma: Mapping[str, Mapping[str, Any]], covariance: FloatArray) -> FloatArray:
    """Return published over predicted sigma (p,) of the reported quantities."""
    return np.asarray(stacked(sigma) / np.sqrt(np.diag(covariance)))


def stacked(bodies: Mapping[str, Mapping[str, Any]]) -> FloatArray:
    """Return mass [kg], centre of mass [m] and inertia [kg m2] of an outcome's bodies, (p,)."""
    parts = [(b["mass_kg"], *b["com_m"], *b["inertia_kg_m2"]) for b in bodies.values()]
    return np.concatenate(parts)


def _firings(config: Config, scenario: Scenario) -> tuple[Firing, ...]:
    if scenario.thrusters is None:
        return ()
    names = [own.name for own in config.thrusters]
    return tuple(
        Firing(thruster=names[p.jet], on_s=p.on_s, for_s=p.for_s)
        for p in scenario.thrusters.pulses
        if p.reported
    )
