"""Whether a configuration and a world are of one robot: each mismatch is one line."""

import numpy as np

from fsw.config import Config
from fsw.config.thrusters import ThrusterConfig
from fsw.config.wheels import WheelConfig
from hil.devices.described import TRIGGERS
from hil.world.links import Link, read_links
from hil.world.scenario import Scenario, ScenarioError

NEAR = 1e-6  # rounding of numbers in a URDF [m, 1]


def require_match(scenario: Scenario, config: Config) -> None:
    """Raise ScenarioError with the first mismatch of bodies, base, robot, devices or buses."""
    fault = (
        _robot(scenario, config)
        or _bodies(scenario, config)
        or _devices(scenario, config)
        or _buses(scenario, config)
    )
    if fault:
        raise ScenarioError(f"{config.name}: {fault}")


def _robot(scenario: Scenario, config: Config) -> str:
    """Return how joints, geometry or tool differ; inertial data may."""
    world, own = read_links(scenario.urdf), read_links(config.resolve(config.robot.urdf))
    names = [link.joint for link in world if link.axis is not None]
    joints = {joint.name: joint for joint in config.joints}
    if sorted(names) != sorted(joints):
        found = f"{len(joints)} ({', '.join(joints)})"
        return f"joints: {found}; must be the world's {len(names)} ({', '.join(names)})"
    by_joint = {link.joint: link for link in own}
    for link in world[1:]:
        other = by_joint.get(link.joint)
        if other is None or not _same(link, other):
            return (
                f"robot.urdf: {config.robot.urdf} has {link.joint!r} otherwise than the world's "
                f"{scenario.urdf}; place, axis and kind must be equal"
            )
        kind = "prismatic" if link.is_prismatic else "revolute"
        if link.joint in joints and joints[link.joint].kind != kind:
            return f"joints: kind of {link.joint!r}: must be {kind}, as in the URDF"
    if config.robot.tool_frame != scenario.tool_frame:
        found = config.robot.tool_frame
        return f"robot.tool_frame: {found!r}; must be the world's {scenario.tool_frame!r}"
    return ""


def _same(one: Link, other: Link) -> bool:
    if (one.parent, one.axis is None, one.is_prismatic) != (
        *(other.parent, other.axis is None, other.is_prismatic),
    ):
        return False
    turn = abs(np.dot(one.q_PL_xyzw, other.q_PL_xyzw))
    apart = np.subtract((*one.p_PL_P_m, *(one.axis or ())), (*other.p_PL_P_m, *(other.axis or ())))
    return bool(np.abs(apart).max() < NEAR and turn > 1.0 - NEAR)


def _bodies(scenario: Scenario, config: Config) -> str:
    for name in config.unknown:
        if name not in scenario.truth:
            return f"unknown: {name!r}; must be one of the world's {', '.join(scenario.truth)}"
    motion = "free" if scenario.stand is None else scenario.stand.motion
    if config.base.motion != motion:
        return f"base.motion: {config.base.motion}; must be {motion}, as the world's stand"
    return ""


def _devices(scenario: Scenario, config: Config) -> str:
    sensors = scenario.sensors
    present = {
        "imu": config.imu.present,
        "star_tracker": config.star_tracker is not None,
        "wheels": bool(config.wheels),
        "thrusters": bool(config.thrusters),
        "wrench_sensors": bool(config.wrench_sensors),
    }
    for key, declared in present.items():
        if declared and sensors.get(key) is None:
            return f"{key}: the world has none; leave it out"
    if config.imu.present and config.imu.driver != "stim300":
        return f"imu.driver: {config.imu.driver}; must be stim300, the bench has no other"
    if config.star_tracker is not None and config.star_tracker.driver != "sagitta":
        driver = config.star_tracker.driver
        return f"star_tracker.driver: {driver}; must be sagitta, the bench has no other"
    rotors = 0 if scenario.wheels is None else len(scenario.wheels.rotors)
    jets = 0 if scenario.thrusters is None else len(scenario.thrusters.jets)
    for key, count in (("wheels", rotors), ("thrusters", jets)):
        found = len(getattr(config, key))
        if found not in (0, count):
            return f"{key}: {found}; must be the world's {count}"
    for k, thruster in enumerate(config.thrusters):
        first = config.thrusters[0]
        if (thruster.bus, thruster.node_id, thruster.valve) != (first.bus, first.node_id, k):
            return f"thrusters.{k}: must be valve {k} of one node, as the bench's are"
    return ""


def _others(config: Config) -> list[WheelConfig | ThrusterConfig]:
    return [*config.wheels, *config.thrusters]


def _wires(config: Config) -> str:
    """Return what the bench cannot do: several feeds, feeds and CAN, several kinds on a bus."""
    drivers = {joint.driver for joint in config.joints}
    if "samples" in drivers and (len(config.buses) > 1 or len(drivers) > 1):
        return "joints: on a feed, and CAN buses; the bench has one feed and no CAN then"
    if "samples" in drivers and config.buses[0].feed is None:
        return "buses.0.feed: missing; the bench flies no samples of a recording"
    described = {joint.bus for joint in config.joints if joint.driver == "described"}
    for other in _others(config):
        if other.driver == "described":
            return f"{other.name}: described; the bench's wheels speak the tailored format"
        if other.bus in described:
            return f"{other.name}: on bus {other.bus!r} of described joints; give it its own bus"
    for joint in config.joints:
        if joint.timing is not None and joint.timing.by not in TRIGGERS:
            return f"{joint.name}: timing by {joint.timing.by}; the bench has no such drive"
    return ""


def _buses(scenario: Scenario, config: Config) -> str:
    used = {joint.bus for joint in config.joints} | {other.bus for other in _others(config)}
    first = config.buses[0]
    if fault := _wires(config):
        return fault
    for k, bus in enumerate(config.buses):
        if bus.name not in used:
            return f"buses.{k}.name: {bus.name!r} has no node"
        for key in ("sync", "sync_counter_max", "latch_offset_s", "rate_hz"):
            if getattr(bus, key) != getattr(first, key):
                return f"buses.{k}.{key}: {getattr(bus, key)}; the bench has one for all buses"
        if bus.redundant is not None and scenario.flight["bus"].get("redundant") is None:
            return f"buses.{k}.redundant: the world's flight.bus has none"
    return ""
