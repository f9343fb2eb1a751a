"""Four reaction wheels in a pyramid for the estimator tests: configuration and random motion."""

from dataclasses import replace
from typing import Any

import numpy as np

from fsw.config import Config
from fsw.config.wheels import WheelConfig
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.problem import Problem
from fsw.messages import Block
from tests.support.estimator_cases import make_config, robot_model

PYRAMID = np.array([[1, 1, 1], [-1, 1, 1], [-1, -1, 1], [1, -1, 1]]) / np.sqrt(3.0)
INERTIA_KG_M2 = 0.02


def wheel_settings(k: int, **changes: Any) -> dict[str, Any]:
    return {
        "name": f"wheel{k + 1}",
        "bus": "arm",
        "node_id": 0x21 + k,
        "rate_hz": 50.0,
        "axis_B": PYRAMID[k].tolist(),
        "inertia_kg_m2": INERTIA_KG_M2,
        "speed_limit_rad_s": 700.0,
        "speed_noise_rad_s": 0.01,
        "torque_limit_nm": 0.4,
    } | changes


def wheel_config(k: int = 0, **changes: Any) -> WheelConfig:
    return WheelConfig.model_validate(wheel_settings(k, **changes))


def config_with_wheels(
    unknown: tuple[str, ...] = ("base", "target"),
    *,
    wheel: dict[str, Any] | None = None,
    **options: Any,
) -> Config:
    data = make_config(unknown, **options).model_dump()
    data["wheels"] = [wheel_settings(k, **(wheel or {})) for k in range(len(PYRAMID))]
    return Config.model_validate(data)


def problem_with_wheels(unknown: tuple[str, ...] = ("base", "target"), **options: Any) -> Problem:
    return build_problem(config_with_wheels(unknown, **options), robot_model())


def turning(block: Block, seed: int = 1) -> Block:
    """Return the block with four wheels that turn somehow."""
    rng = np.random.default_rng(seed)
    m, k = len(block.t_ns), len(PYRAMID)
    roots = rng.normal(size=(k, 2 * m, 2 * m))
    return replace(
        block,
        carried_nms=2.0 * rng.normal(size=(m, k)),
        carried_nm=0.2 * rng.normal(size=(m, k)),
        cov_carried=1e-6 * roots @ roots.transpose(0, 2, 1),
    )
