"""Eight thrusters on the base for the estimator tests: configuration, firings."""

from dataclasses import replace
from typing import Any

import numpy as np

from fsw.config import Config
from fsw.messages import MOST_EDGES, Block, FloatArray
from tests.support.estimator_cases import make_config

FORCE_N = 22.0
CORNERS = np.array([[x, y, z] for x in (0.0, 1.6) for y in (-1.1, 0.3) for z in (-0.6, 1.0)])
WAYS = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0]] * 2, dtype=float)
STAR_TRACKER = {
    "port": "/dev/star",
    "rate_hz": 5.0,
    "mounting": {"p_BS_m": (0.0, 0.0, 0.0), "q_BS_xyzw": (0.0, 0.0, 0.0, 1.0)},
    "latency_s": 0.1,
    "rotation": "inertial_to_tracker",
    "noise_across_rad": 1e-5,
    "noise_about_rad": 5e-5,
}


def thruster_settings(k: int, **changes: Any) -> dict[str, Any]:
    return {
        "name": f"thruster{k + 1}",
        "bus": "arm",
        "node_id": 0x31,
        "valve": k,
        "rate_hz": 50.0,
        "p_B_m": CORNERS[k].tolist(),
        "direction_B": WAYS[k].tolist(),
        "force_n": FORCE_N,
        "delay_sigma_s": 2e-3,
        "rise_sigma_s": 2e-3,
    } | changes


def config_with_thrusters(
    unknown: tuple[str, ...] = ("base", "target"),
    *,
    thruster: dict[str, Any] | None = None,
    count: int = len(CORNERS),
    **options: Any,
) -> Config:
    data = make_config(unknown, **options).model_dump()
    data["thrusters"] = [thruster_settings(k, **(thruster or {})) for k in range(count)]
    data["star_tracker"] = STAR_TRACKER
    return Config.model_validate(data)


def edges_of(firings: list[tuple[int, float, float]], centre_s: float) -> FloatArray:
    """Return a block's edges of firings (thruster, on, off), a closing at infinity left out."""
    rows = []
    for k, on_s, off_s in firings:
        rows += [(k, on_s - centre_s, 1.0)] + [(k, off_s - centre_s, -1.0)] * (off_s < np.inf)
    edges = np.zeros((MOST_EDGES, 3))
    edges[: len(rows)] = np.array(rows).reshape(-1, 3)
    return edges


def firing(block: Block, seed: int = 1, count: int = len(CORNERS)) -> Block:
    """Return the block with valves that open and close somehow, within it and before."""
    rng = np.random.default_rng(seed)
    on_s = rng.uniform(-0.6, 0.15, size=count)
    firings = [(k, t, t + rng.uniform(0.02, 0.5)) for k, t in enumerate(on_s.tolist())]
    return replace(block, edges=edges_of(firings, 0.0), opened_s=rng.uniform(0, 3, size=count))
