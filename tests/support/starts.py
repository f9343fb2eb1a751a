"""Configurations whose unknown bodies start 30-50 % off, by case, and bodies that change."""

from functools import lru_cache
from typing import Any

import numpy as np

from fsw.config import Config
from fsw.messages import Block, FloatArray
from hil.world.spline import JointSpline
from hil.world.truth import Body, Robot, simulate
from tests.support.estimator_cases import (
    BASE,
    HIL,
    MOTION,
    TARGET,
    URDF,
    WINDOW_S,
    make_config,
    parameters,
    true_block,
    true_blocks_cached,
    wrong,
)

CASES = {
    "base": ("base", ("base",)),
    "target": ("target", ("target",)),
    "both": ("target", ("base", "target")),
}
STEP_AT = 75  # block, in the middle of the motion


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


def heavier(body: Body, ratio: float) -> Body:
    inertia = tuple(np.array(body.inertia_kg_m2) * ratio)
    return Body(body.mass_kg * ratio, body.com_m, inertia)


@lru_cache(maxsize=4)
def stepped(kind: str, base_ratio: float, target_ratio: float) -> tuple[Block, ...]:
    """Return clean blocks of the same joint motion whose bodies step in mass and inertia."""
    spline = JointSpline.load(HIL / "trajectories" / f"{MOTION[kind]}.yaml")
    target = heavier(TARGET, target_ratio) if kind == "target" else None
    robot = Robot.load(URDF, "tool", base=heavier(BASE, base_ratio), target=target)
    history = simulate(robot, spline, -3.0, spline.duration_s + 1.0, dt_s=0.01)
    before = true_blocks_cached(kind, 59.9)
    after = [true_block(history, k * WINDOW_S, k) for k in range(STEP_AT, len(before))]
    return (*before[:STEP_AT], *after)
