"""The planner's prediction for the motion of a scenario, beside what its runs publish.

The prediction includes every state and is made at the true bodies. So it is the Cramer-Rao bound
of the sensors and uncertainties that the configuration declares.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from fsw.config import Config
from fsw.estimators.model.inertia import report_jacobian, to_parameters
from hil.world.inertia import FloatArray
from hil.world.scenario import Scenario
from planner import criteria, spline
from planner.firings import Firing
from planner.foreseen import foreseen_root
from planner.subject import build_subject


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
