"""The files of the flight side: configuration and robot, without the truth of unknown bodies."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from hil.run.flight_effects import draws, mode_sections, thruster_sections, wheel_sections
from hil.run.flight_sensors import foreign_bus, imu_section, joint_sections, star_tracker_section
from hil.world.base_urdf import replace_base
from hil.world.environment.config import OrbitSection
from hil.world.environment.orbit import Orbit
from hil.world.inertia import FloatArray
from hil.world.links import read_links
from hil.world.prior import Prior
from hil.world.robot import Robot
from hil.world.scenario import Scenario, ScenarioError, mapping_from
from hil.world.sensor_config import SensorConfig

URDF, FLIGHT = "robot.urdf", "flight.yaml"


def flight_document(
    scenario: Scenario,
    priors: Mapping[str, Prior],
    joint_names: tuple[str, ...],
    folder: Path,
    bus_ports: Mapping[str, int],
    overrides: Mapping[str, Any],
    *,
    start_rad: Sequence[float] = (),
    stamp_noise_rad: float = 0.0,
    seed: int | None = 0,
) -> dict[str, Any]:
    """Return the flight configuration: data sheets, mounting, known bodies, priors of unknown ones.

    Arm and calibration are declared exact, because robot file and scenario hold the true values.

    Parameters
    ----------
    folder : where the real-time plant makes its serial lines
    overrides : keys of the section `estimator`
    start_rad : the joints' angles where the motion begins; zero by default
    stamp_noise_rad : noise that the jitter of a software stamp of SYNC adds to the positions
    seed : fixes the errors of wheels, thrusters, modes and angles at the start; None: no errors
    """
    sensors = SensorConfig.from_dict(scenario.sensors)
    flight = scenario.flight
    bodies: dict[str, Any] = {}
    for body, report in scenario.truth.items():
        if body in priors:
            prior = priors[body]
            bodies[body] = mapping_from(prior.report) | {"sigma": mapping_from(prior.sigma)}
            if body == "base" and scenario.slosh and not flight.get("modes"):
                bodies[body]["liquid"] = [
                    {
                        "mass_kg": part.mass_kg,
                        "place_m": list(part.place_m),
                        "stroke_m": part.stroke_m,
                    }
                    for part in scenario.slosh
                ]
        else:
            bodies[body] = mapping_from(report)
        if body in scenario.frames:
            bodies[body]["frame"] = scenario.frames[body]
    begin_rad = [
        angle + sensors.joints.start_sigma_rad * float(draws(seed, "joint", (), i, 4))
        for i, angle in enumerate(start_rad or [0.0] * len(joint_names))
    ]
    sliding = {link.joint for link in read_links(scenario.urdf) if link.is_prismatic}
    joints = joint_sections(sensors, flight, joint_names, sliding, begin_rad, stamp_noise_rad)
    order = () if sensors.joints.feed is None else sensors.joints.feed.order
    joints = [joints[k] for k in order] or joints
    document: dict[str, Any] = {
        "robot": {"urdf": URDF, "tool_frame": scenario.tool_frame, "links_sigma_ratio": 0.0},
        "bodies": bodies,
        "unknown": list(scenario.unknown),
        "buses": [
            _feed(name, sensors, bus_ports, folder)
            if sensors.joints.feed is not None
            else {
                "name": name,
                **settings,
                "port": bus_ports.get(name),
                "fd": any(joint.get("format") == "fd" for joint in joints if joint["bus"] == name),
                "sync": "producer" if sensors.joints.sync_rate_hz is None else "consumer",
                "sync_counter_max": sensors.joints.sync_counter_max,
                "latch_offset_s": sensors.joints.latch_offset_s,
                **foreign_bus(sensors, name, len(joint_names)),
            }
            for name, settings in scenario.buses.items()
        ],
        "joints": joints,
        "scheduler": {"tick_rate_hz": flight["tick_rate_hz"]},
        "estimator": dict(flight["estimator"]) | dict(overrides),
        "recorder": {"directory": "recording"},
        "service": {"state_directory": "state"},
    }
    if scenario.wheels is not None and sensors.wheels is not None:
        document["wheels"] = wheel_sections(scenario.wheels, sensors.wheels, seed)
    if scenario.thrusters is not None and sensors.thrusters is not None:
        document["thrusters"] = thruster_sections(scenario.thrusters, sensors.thrusters, seed)
    document |= _excitation(flight)
    if flight.get("modes"):
        document["modes"] = mode_sections(scenario, flight["modes"], seed)
    if sensors.star_tracker is not None:
        document["star_tracker"] = star_tracker_section(sensors, folder)
    stand = scenario.stand
    if sensors.imu is not None or stand is None or stand.motion != "clamped":
        document["imu"] = imu_section(sensors, folder)
    if stand is not None:
        gravity = list(stand.gravity_m_s2)
        document["base"] = {"motion": stand.motion, "gravity_B_m_s2": gravity}
    environment = scenario.environment
    if environment is not None and environment.told_to_flight and environment.gravity_gradient:
        document["orbit"] = _orbit(environment.orbit, scenario.before_s)
    return document


def _feed(
    name: str, sensors: SensorConfig, bus_ports: Mapping[str, int], folder: Path
) -> dict[str, Any]:
    """Return the bus section of a live feed on the loopback address; write its key, if any."""
    feed = sensors.joints.feed
    if feed is None:
        raise ScenarioError("sensors.joints.feed: missing")
    section: dict[str, Any] = {"source": feed.source, "clock": feed.clock}
    if feed.key_hex is not None:
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / "feed.key"
        path.write_bytes(bytes.fromhex(feed.key_hex))
        path.chmod(0o600)
        section["key_file"] = str(path.absolute())
    return {
        "name": name,
        "interface": "samples",
        "channel": "127.0.0.1",
        "port": bus_ports.get(name),
        "rate_hz": feed.rate_hz,
        "latch_offset_s": sensors.joints.latch_offset_s,
        "feed": section,
    }


def _excitation(flight: Mapping[str, Any]) -> dict[str, Any]:
    own = flight.get("excitation")
    return {"excitation": own | {"limits": str(Path(own["limits"]).resolve())}} if own else {}


def _orbit(section: OrbitSection, before_s: float) -> dict[str, Any]:
    """Return the orbit's state at the first SYNC, `before_s` before the motion."""
    orbit = Orbit.from_section(section)
    return {
        "position_m": orbit.position_m(-before_s).tolist(),
        "velocity_m_s": orbit.velocity_m_s(-before_s).tolist(),
    }


def on_socketcan(scenario: Scenario) -> Scenario:
    """Return the scenario with its buses on vcan0, vcan1, ..., and a redundant bus on the next."""
    bus = {key: value for key, value in scenario.flight["bus"].items() if key != "port"}
    bus |= {"interface": "socketcan", "channel": "vcan0"}
    several = enumerate((scenario.flight.get("buses") or {}).items())
    buses = {name: own | {"port": None, "channel": f"vcan{k}"} for k, (name, own) in several}
    if bus.get("redundant") is not None:
        second = {key: value for key, value in bus["redundant"].items() if key != "port"}
        bus["redundant"] = second | {"channel": f"vcan{max(1, len(buses))}"}
    return replace(scenario, flight=scenario.flight | {"bus": bus, "buses": buses})


def on_frames(scenario: Scenario) -> Scenario:
    """Return the scenario with UDP datagrams that hold SocketCAN's struct can_frame."""
    bus = scenario.flight["bus"] | {"interface": "udp_frames"}
    return replace(scenario, flight=scenario.flight | {"bus": bus})


def write_flight(
    folder: Path, scenario: Scenario, priors: Mapping[str, Prior], document: Mapping[str, Any]
) -> Path:
    """Write the flight configuration and its robot file; return the path of the configuration."""
    folder.mkdir(parents=True, exist_ok=True)
    base: FloatArray = priors["base"].report if "base" in priors else scenario.truth["base"]
    (folder / URDF).write_text(replace_base(scenario.urdf, base), encoding="utf-8")
    return write_yaml(folder / FLIGHT, document)


def write_yaml(path: Path, document: Mapping[str, Any]) -> Path:
    """Write a YAML file; return its path."""
    text = yaml.safe_dump(dict(document), sort_keys=False, default_flow_style=None, width=100)
    path.write_text(text, encoding="utf-8")
    return path


def joint_names(scenario: Scenario) -> tuple[str, ...]:
    """Return the robot's joints from base to tool."""
    return Robot.load(scenario.urdf, scenario.tool_frame).joint_names
