"""The plant's file for a run in real time: the truth, which the flight side never reads."""

import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hil.run.flight_sensors import has_fd
from hil.world.scenario import Scenario, mapping_from
from hil.world.sensor_config import SensorConfig


def plant_document(
    scenario: Scenario, seed: int, folder: Path, bus_ports: Mapping[str, int]
) -> dict[str, Any]:
    """Return the file's content, for the reader in `hil/devices/plant_file.py`."""
    sensors = SensorConfig.from_dict(scenario.sensors)
    links: dict[str, Any] = {
        "buses": [
            {
                "name": name,
                "interface": bus["interface"],
                "channel": bus["channel"],
                "port": bus_ports.get(name),
                "fd": has_fd(sensors.joints, name),
                "redundant": _second_link(bus),
            }
            for name, bus in scenario.buses.items()
            if sensors.joints.feed is None
        ],
        "imu": "imu",
    }
    if sensors.joints.feed is not None:
        links["feed"] = {"host": "127.0.0.1", "port": next(iter(bus_ports.values()))}
    if sensors.star_tracker is not None:
        links["star_tracker"] = "star_tracker"
    return {
        "robot": {
            "urdf": os.path.relpath(scenario.urdf, folder),
            "tool_frame": scenario.tool_frame,
        },
        "trajectory": os.path.relpath(scenario.identification, folder),
        "bodies": _true_bodies(scenario),
        "sensors": scenario.sensors,
        "links": links,
        "environment": (
            None if scenario.environment is None else scenario.environment.model_dump(mode="json")
        ),
        "slosh": [asdict(part) for part in scenario.slosh],
        "panels": [asdict(part) for part in scenario.panels],
        "stand": None if scenario.stand is None else asdict(scenario.stand),
        "wheels": None if scenario.wheels is None else asdict(scenario.wheels),
        "thrusters": None if scenario.thrusters is None else asdict(scenario.thrusters),
        "contact": None if scenario.contact is None else asdict(scenario.contact),
        "start_rate_rad_s": list(scenario.start_rate_rad_s),
        "start_delay_s": scenario.before_s,
        "rate_hz": float(scenario.flight["bus"]["rate_hz"]),
        "seed": seed,
        "realtime": {"priority": 40},
    }


def _true_bodies(scenario: Scenario) -> dict[str, Any]:
    held = {frame: mapping_from(scenario.truth[name]) for name, frame in scenario.frames.items()}
    own = {b: mapping_from(r) for b, r in scenario.truth.items() if b not in scenario.frames}
    return own | ({"held": held} if held else {})


def _second_link(bus: Mapping[str, Any]) -> dict[str, Any] | None:
    second = bus.get("redundant")
    return None if second is None else {key: second.get(key) for key in ("channel", "port")}
