"""Predicted sigma of a scenario's motion beside the sigma of its flight from bytes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fsw.config import Config
from fsw.estimators.model.inertia import report_jacobian, to_parameters
from fsw.excitation import criteria, spline
from fsw.excitation.foreseen import foreseen_root
from fsw.excitation.subject import build_subject
from hil.judge import judgement
from hil.run import bench
from hil.run.progress import Quiet
from hil.world.inertia import FloatArray
from hil.world.scenario import Scenario, load


def predicted(config: Config, scenario: Scenario) -> FloatArray:
    """Return the predicted sigma (p,) of the reported quantities, at the true bodies."""
    own = build_subject(config)
    reports = [scenario.truth[body] for body in own.problem.unknown]
    x = np.concatenate([to_parameters(r[0], r[1:4], r[4:]) for r in reports])
    T = np.zeros((len(x), len(x)))
    for body in own.problem.unknown:
        k = own.problem.body(body)
        T[k, k] = report_jacobian(x[k])
    motion = replace(spline.load(scenario.identification), firings=_firings(config, scenario))
    own = replace(own, x=x, scale=replace(own.scale, T=T))
    return np.asarray(
        np.sqrt(np.diag(criteria.report_covariance(foreseen_root(own, motion), own.scale)))
    )


def ratios(sigma: Mapping[str, Mapping[str, object]], expected: FloatArray) -> FloatArray:
    """Return flown over predicted sigma (p,); `sigma` of an outcome of `hil run`."""
    flown = [
        np.r_[body["mass_kg"], body["com_m"], body["inertia_kg_m2"]] for body in sigma.values()
    ]
    return np.asarray(np.concatenate(flown) / expected)


def _firings(config: Config, scenario: Scenario) -> tuple[spline.Firing, ...]:
    if scenario.thrusters is None:
        return ()
    names = [own.name for own in config.thrusters]
    return tuple(
        spline.Firing(thruster=names[p.jet], on_s=p.on_s, for_s=p.for_s)
        for p in scenario.thrusters.pulses
        if p.reported
    )


def flown(name: str, seed: int) -> FloatArray:
    """Fly a scenario in virtual time; return flown over predicted sigma (p,)."""
    with TemporaryDirectory(prefix="hil-") as folder:
        setup = bench.prepare(load(name), seed, Path(folder))
        recorded = bench.run_virtual(setup, Quiet(), record=False)
        outcome = judgement.judge(setup, judgement.make_case(setup), recorded)
        return ratios(outcome["sigma"], predicted(setup.config, setup.scenario))
