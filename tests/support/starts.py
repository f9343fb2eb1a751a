"""Configurations whose unknown bodies start 30-50 % off, by case."""

from __future__ import annotations

from typing import Any

import numpy as np

from fsw.config import Config
from fsw.messages import FloatArray
from tests.support.estimator_cases import BASE, TARGET, make_config, parameters, wrong

CASES = {
    "base": ("base", ("base",)),
    "target": ("target", ("target",)),
    "both": ("target", ("base", "target")),
}


def config_of(case: str, seed: int, **options: Any) -> Config:
    """Return a configuration whose unknown bodies start 30-50 % off."""
    kind, unknown = CASES[case]
    rng = np.random.default_rng(1000 + seed)
    base = wrong(BASE, rng) if "base" in unknown else BASE
    target = wrong(TARGET, rng) if "target" in unknown else TARGET
    return make_config(unknown, base=base, target=target if kind == "target" else None, **options)


def truth_of(case: str) -> FloatArray:
    """Return pi of the case's unknown bodies, stacked."""
    bodies = {"base": BASE, "target": TARGET}
    return np.concatenate([parameters(bodies[name]) for name in CASES[case][1]])


def misjudged(case: str, factor: float, sigma_ratio: float, **options: Any) -> Config:
    """Return a configuration whose unknown bodies have masses and inertias `factor` times true.

    Their sigmas are a share of the true values: of masses, diagonals of the inertia and the centre
    of mass, and of products of inertia at least a tenth of the mean diagonal's.
    """
    kind, unknown = CASES[case]
    config = make_config(unknown, target=TARGET if kind == "target" else None, **options)
    data = config.model_dump()
    for name in unknown:
        true = {"base": BASE, "target": TARGET}[name]
        inertia = np.array(true.inertia_kg_m2)
        mean_kg_m2 = float(inertia[[0, 3, 5]].mean())
        data["bodies"][name] = {
            "mass_kg": factor * true.mass_kg,
            "com_m": list(true.com_m),
            "inertia_kg_m2": list(factor * inertia),
            "sigma": {
                "mass_kg": sigma_ratio * true.mass_kg,
                "com_m": [max(sigma_ratio, 0.02) * max(abs(c), 0.3) for c in true.com_m],
                "inertia_kg_m2": [
                    sigma_ratio * max(abs(value), 0.1 * mean_kg_m2) for value in inertia
                ],
            },
        }
    return type(config).model_validate(data)
