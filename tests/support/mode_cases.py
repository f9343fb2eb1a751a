"""A hinged panel and a tank for the estimator tests: configuration, and truth by another engine."""

from functools import lru_cache
from typing import Any

from fsw.config import Config
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.problem import Problem
from fsw.messages import Block
from hil.world.robot import Robot
from hil.world.spline import JointSpline
from hil.world.springs import Panel, SloshMass
from hil.world.truth import simulate
from tests.support.estimator_cases import (
    BASE,
    HIL,
    MOTION,
    TARGET,
    URDF,
    WINDOW_S,
    make_config,
    robot_model,
    true_block,
)

PANEL = Panel(
    mass_kg=25.0,
    place_m=(0.855, -0.408, 1.441),
    axis=(1.0, 0.0, 0.0),
    com_m=(0.1, 0.0, 1.5),
    inertia_kg_m2=(18.75, 0.2, -0.1, 22.8, 0.3, 4.3),
    frequency_hz=0.25,
    damping_ratio=0.02,
)
TANK = SloshMass(
    mass_kg=25.0, place_m=(0.8, -0.8, 0.8), frequency_hz=0.08, damping_ratio=0.05, stroke_m=1.0
)
AMPLITUDE = {"amplitude_rad": 1e-3, "amplitude_m": 5e-3}


def mode_settings(part: Panel | SloshMass, **changes: Any) -> dict[str, Any]:
    settings: dict[str, Any] = {
        "name": "tank",
        "kind": "slosh",
        "p_B_m": part.place_m,
        "axes_B": part.axes,
        "mass_kg": part.mass_kg,
        "frequency_hz": part.frequency_hz,
        "damping_ratio": part.damping_ratio,
        "amplitude_m": AMPLITUDE["amplitude_m"],
    }
    if isinstance(part, Panel):
        del settings["amplitude_m"]
        settings |= {"name": "panel", "kind": "panel", "com_m": part.com_m}
        settings |= {"inertia_kg_m2": part.inertia_kg_m2}
        settings |= {"amplitude_rad": AMPLITUDE["amplitude_rad"]}
    return settings | changes


def config_with_modes(
    unknown: tuple[str, ...] = ("target",),
    modes: list[dict[str, Any]] | None = None,
    **options: Any,
) -> Config:
    data = make_config(unknown, **options).model_dump()
    data["modes"] = [mode_settings(PANEL), mode_settings(TANK)] if modes is None else modes
    return Config.model_validate(data)


def problem_with_modes(*arguments: Any, **options: Any) -> Problem:
    return build_problem(config_with_modes(*arguments, **options), robot_model())


@lru_cache(maxsize=1)
def true_blocks(count: int) -> tuple[Block, ...]:
    """Return noise-free blocks of the arm, target, panel and tank at rest at first, by MuJoCo."""
    spline = JointSpline.load(HIL / "trajectories" / f"{MOTION['target']}.yaml")
    robot = Robot.load(URDF, "tool", base=BASE, target=TARGET, slosh=[TANK], panels=[PANEL])
    history = simulate(robot, spline, 0.0, count * WINDOW_S + 1.0, dt_s=0.005)
    return tuple(true_block(history, k * WINDOW_S, k) for k in range(count))
