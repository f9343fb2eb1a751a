"""A short, slow-rate scenario: the first seconds of a motion, cheap enough for any machine."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hil.world.scenario import Scenario, load
from hil.world.spline import REST_POINTS, JointSpline

RATE_HZ = 200.0
IMU_RATE_HZ = 125
REDUNDANT = {"channel": "239.74.163.3", "port": 43114}
HEARTBEAT_S = 0.1
LOST_AFTER_S = 0.1
CONSUMER_HEARTBEAT_S = 0.15


class NoMeter:
    """Shows nothing."""

    def update(self, done_s: float, summary: Any) -> None:
        pass


def short(
    folder: Path,
    points: int = 8,
    rate_hz: float = RATE_HZ,
    hurry: float = 1,
    name: str = "target_leo",
) -> Scenario:
    """Return a scenario at a low rate, coming to rest at its spline's control point `points`.

    `hurry` shortens the motion, and its excursions by the square, so that torques stay.
    """
    scenario = load(name)
    full = JointSpline.load(scenario.identification)
    rows = full.control_points_rad[: REST_POINTS + points]
    rows = np.vstack([rows, *(rows[-1:],) * (REST_POINTS - 1)])
    motion = JointSpline(full.knot_spacing_s * (len(rows) - 5) / hurry, rows)
    motion.scaled(hurry**-2).save(folder / "motion.yaml")
    imu = scenario.sensors.get("imu")
    return replace(
        scenario,
        identification=folder / "motion.yaml",
        before_s=1.0,
        after_s=0.5,
        sensors=scenario.sensors | ({"imu": imu | {"rate_hz": IMU_RATE_HZ}} if imu else {}),
        flight=scenario.flight
        | {
            "bus": scenario.flight["bus"] | {"rate_hz": rate_hz},
            "tick_rate_hz": rate_hz,
        },
    )


def on_two_buses(scenario: Scenario, slower: float = 1.0) -> Scenario:
    """Return the scenario with a redundant bus; the nodes toggle after 2 x 0.15 s, or `slower`."""
    second = REDUNDANT | {
        "lost_after_s": LOST_AFTER_S * slower,
        "nodes_toggle_s": 2 * CONSUMER_HEARTBEAT_S * slower,
    }
    bus = scenario.flight["bus"] | {"heartbeat_s": HEARTBEAT_S, "redundant": second}
    nodes = {"ttoggle": 2, "consumer_heartbeat_s": CONSUMER_HEARTBEAT_S * slower}
    joints = scenario.sensors["joints"] | {"redundancy": nodes}
    return replace(
        scenario,
        flight=scenario.flight | {"bus": bus},
        sensors=scenario.sensors | {"joints": joints},
    )
