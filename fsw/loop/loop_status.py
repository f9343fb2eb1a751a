"""The loop's counters as plain values: ticks, samples, links, buses, windows."""

from __future__ import annotations

from typing import Any

from fsw.config import Config
from fsw.estimators.pipeline import BlockSource, Gating
from fsw.exchange.status import source_samples, task_summary, time_values
from fsw.loop.inputs import Inputs
from fsw.loop.ports import CAN, JOINTS
from fsw.scheduler.align import Aligner
from fsw.scheduler.tasks import Slips


def tick_status(slips: Slips) -> dict[str, Any]:
    """Return how many ticks there were, and how long their work took."""
    return {
        "ticks": slips.ticks,
        "slips": slips.slips,
        "stalls": slips.stalls,
        "over_budget": slips.over_budget,
        "max_late_us": slips.max_late_ns / 1e3,
        "work_us": time_values(slips.work),
        "tasks_us": task_summary(slips),
    }


def sample_status(config: Config, align: Aligner, inputs: Inputs) -> dict[str, Any]:
    """Return the counters of sources, links and buses."""
    buses = inputs.buses
    late = align.counters().late
    for bus in buses:
        late[bus.name] = sum(late[joint.name] for joint in config.joints if joint.bus == bus.name)
    late[JOINTS] = sum(late[joint.name] for joint in config.joints)
    return {
        "samples": {m.name: source_samples(m.source.counters, late[m.name]) for m in inputs},
        "links": {link.name.removeprefix(CAN): link.summary() for m in inputs for link in m.links},
        "buses": {bus.name: bus.summary() for bus in buses},
        "joints": {name: slow for bus in buses for name, slow in bus.source.motor_side().items()},
        **_others(inputs),
        "late_joints": {joint.name: late[joint.name] for joint in config.joints},
    }


def _others(inputs: Inputs) -> dict[str, Any]:
    """Return the newest values and counters of wheels and thrusters, by kind."""
    found: dict[str, dict[str, Any]] = {}
    for source in (own for bus in inputs.buses for own in bus.others):
        found.setdefault(source.kind, {}).update(source.status())
    return found


def window_status(align: Aligner, unusable: int, conditioner: BlockSource) -> dict[str, Any]:
    """Return the counters of the windows."""
    counters = align.counters()
    return {
        "closed": align.next_index,
        "unusable": unusable,
        "outliers": conditioner.outliers if isinstance(conditioner, Gating) else 0,
        "early": counters.early,
        "future": counters.future,
        "overflow": counters.overflow,
    }
