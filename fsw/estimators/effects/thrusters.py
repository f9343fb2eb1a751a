"""Thrusters: what is in doubt of each, what their valves report, and their forces."""

from collections.abc import Mapping

import numpy as np

from fsw.config import Config, ThrusterConfig
from fsw.estimators.effects.device import Device, Driven, Samples
from fsw.estimators.effects.switched import Switched
from fsw.estimators.model.state_group import StateGroup, per_part
from fsw.estimators.valves import Valves
from fsw.messages import FloatArray, IntArray

FORCE = StateGroup(  # relative error of each thruster's force
    name="thrust_scale",
    effect="force of thrusters",
    unit="",
    key="thrusters[].force_sigma_ratio",
    cause="thrusters",
    prior=per_part("thrusters", "force_sigma_ratio"),
    is_calibration=True,
    shared=0.5,  # one supply pressure
    mistake="force_n of thrusters",
)
DELAY = StateGroup(  # true delay less the configured one
    name="thrust_delay",
    effect="delay of thrusters",
    unit="s",
    key="thrusters[].delay_sigma_s",
    cause="thrusters",
    prior=per_part("thrusters", "delay_sigma_s"),
    is_calibration=True,
    mistake="delay_s of thrusters",
)
RISE = StateGroup(  # true rise time less the configured one
    name="thrust_rise",
    effect="rise of thrusters",
    unit="s",
    key="thrusters[].rise_sigma_s",
    cause="thrusters",
    prior=per_part("thrusters", "rise_sigma_s"),
    is_calibration=True,
    mistake="rise_s of thrusters",
)


def _opening(_own: ThrusterConfig, t_s: FloatArray, _window_s: float) -> FloatArray:
    """Return the reports of a valve that opens after its first one."""
    is_open = (t_s > t_s[0]).astype(np.float64)
    return np.stack([is_open, np.diff(is_open, prepend=0.0)], axis=1)


def _fired(
    own: ThrusterConfig, _i: int, t_ns: IntArray, span_ns: tuple[int, int], driven: Driven
) -> Samples:
    """Return a valve's periodic reports and its changes, each change at its exact time."""
    edges = [
        (round(time_s * 1e9), state)
        for on_s, for_s in driven.firings.get(own.name, ())
        for time_s, state in ((on_s, 1.0), (on_s + for_s, 0.0))
    ]
    changes = [edge for edge in edges if span_ns[0] <= edge[0] < span_ns[1]]
    before = [(int(t), max((e for e in edges if e[0] < t), default=(0, 0.0))[1], 0.0) for t in t_ns]
    rows = sorted([*before, *((t, state, 1.0) for t, state in changes)], key=lambda row: row[0])
    return np.array([r[0] for r in rows]), np.array([r[1:] for r in rows])


def switched(config: Config, places: Mapping[str, slice]) -> Switched:
    """Return the thrusters of a configuration, for a state whose groups are at `places`."""
    own = config.thrusters
    force = np.array([t.force_n * np.array(t.direction_B) for t in own]).reshape(-1, 3)
    place = np.array([t.p_B_m for t in own]).reshape(-1, 3)
    ways = np.concatenate([force, np.cross(place, force)], axis=1).T
    times = np.array([(t.delay_s, t.rise_s) for t in own]).reshape(-1, 2)
    states = (places.get(group.name) for group in (FORCE, DELAY, RISE))
    return Switched(ways, times[:, 0], times[:, 1], config.estimator.window_s, *states)


def _follow(config: Config) -> Valves:
    return Valves(config.thrusters, switched(config, {}).tail_s)


def _unplanned(fires: bool) -> str:
    if fires:
        return "thrusters: limits of the base do not count what the firings move"
    return "thrusters: counted without a firing; name them in `firings`"


THRUSTERS = Device(
    section="thrusters", gentle=_opening, along=_fired, follow=_follow, unplanned=_unplanned
)


def words(config: Config) -> list[str]:
    """Return a line for each thruster, and a line on what the model contains."""
    lines = []
    for own in config.thrusters:
        place, way = (" ".join(f"{x:.4g}" for x in v) for v in (own.p_B_m, own.direction_B))
        lines.append(
            f"{own.name}: {own.force_n:.4g} N +- {own.force_sigma_ratio:.1%} at [{place}] m along "
            f"[{way}], delay {1e3 * own.delay_s:.3g} +- {1e3 * own.delay_sigma_s:.3g} ms, rise "
            f"{1e3 * own.rise_s:.3g} +- {1e3 * own.rise_sigma_s:.3g} ms"
        )
    return [*lines, "modelled: force, delay and rise of each; propellant that leaves is not"]
