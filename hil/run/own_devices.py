"""Devices and arm of the world as a configuration describes them, drawn within its doubts.

What a configuration declares with a sigma is true within this sigma only. So every seed has a robot
of its own: links, zeros and gains of joints, and the mounting of the inertial unit are drawn.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fsw.config import BusConfig, Config, ImuConfig, JointConfig, StarTrackerConfig
from fsw.config.feed import SHARED_CLOCKS
from fsw.config.keys import read_key
from hil.run.flight_effects import draws
from hil.world.doubts import drawn_body, drawn_links, turned
from hil.world.inertia import FloatArray
from hil.world.links import read_links
from hil.world.scenario import Scenario, report_from
from hil.world.sensors import generator

URDF = "world.urdf"  # with the drawn links; the flight side never reads it
UNIX_S = 1.8e9  # a time of day of the sender of a feed
FD_RATES = {"bitrate": 1_000_000, "data_bitrate": 5_000_000}  # of the bench's buses
CALIBRATION, LINKS = 5, 6  # streams of a joint or an inertial unit: its errors, its link's


def described(
    scenario: Scenario, config: Config, unknown: tuple[str, ...], seed: int, folder: Path
) -> Scenario:
    """Return the scenario with the devices of a configuration and the errors that it allows."""
    folder.mkdir(parents=True, exist_ok=True)
    ratio = config.robot.links_sigma_ratio
    own = {joint.name: joint.link_sigma_ratio for joint in config.joints}
    ratios = {"": ratio} | {k: ratio if v is None else v for k, v in own.items()}
    urdf = folder / URDF
    text = drawn_links(scenario.urdf, ratios, lambda k: generator(seed, "joint", k, LINKS))
    urdf.write_text(text, encoding="utf-8")
    truth = {
        name: report if name in unknown else _known(config, name, report, seed, 1000 + k)
        for k, (name, report) in enumerate(scenario.truth.items())
    }
    return replace(
        scenario,
        urdf=urdf,
        truth=truth,
        unknown=unknown,
        sensors=_sensors(scenario, config, seed),
        flight=_flight(scenario, config),
    )


def _known(config: Config, name: str, report: FloatArray, seed: int, index: int) -> FloatArray:
    """Return the truth of a known body, which is within the doubts of its declaration."""
    body, rng = config.bodies.get(name), generator(seed, "joint", index, LINKS)
    if body is None and name != "base":
        return report
    if body is None or body.sigma is None:
        return drawn_body(report, config.robot.links_sigma_ratio, rng)
    sigma = report_from({key: getattr(body.sigma, key) for key in type(body.sigma).model_fields})
    return report + sigma * rng.standard_normal(len(sigma))


def _sensors(scenario: Scenario, config: Config, seed: int) -> dict[str, Any]:
    world = scenario.sensors
    joints = {joint.name: joint for joint in config.joints}
    buses = {bus.name: bus for bus in config.buses}
    bus = config.buses[0]
    names = [link.joint for link in read_links(scenario.urdf) if link.axis is not None]
    sensors: dict[str, Any] = {
        "joints": world["joints"]
        | {
            "nodes": [
                _node(joints[name], k, seed)
                | {"described": _described(config, buses[joints[name].bus], joints[name])}
                for k, name in enumerate(names)
            ],
            "feed": _feed(config, bus, names, world["joints"].get("feed") or {}),
            "dialect": None,
            "torque_scale_error_ratio": 0.0,  # each node has its own gain
            "sync_counter_max": bus.sync_counter_max,
            "sync_rate_hz": bus.rate_hz if bus.sync == "consumer" else None,
            "latch_offset_s": bus.latch_offset_s,
        }
    }
    if config.imu.present:
        sensors["imu"] = _mounted(world["imu"]) | _imu(config.imu, seed)
    if config.star_tracker is not None:
        sensors["star_tracker"] = _mounted(world["star_tracker"]) | _tracker(config.star_tracker)
    if config.wheels:
        nodes = [{"node_id": wheel.node_id, "bus": wheel.bus} for wheel in config.wheels]
        sensors["wheels"] = world["wheels"] | {"nodes": nodes, "rate_hz": config.wheels[0].rate_hz}
    if config.thrusters:
        first = config.thrusters[0]
        sensors["thrusters"] = {key: getattr(first, key) for key in ("bus", "node_id", "rate_hz")}
    return sensors


def _mounted(section: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in section.items() if key != "rpy_BS_rad"}


def _node(joint: JointConfig, index: int, seed: int) -> dict[str, Any]:
    """Return a node that the joint's section calibrates but for errors of its sigmas."""
    zero, scale = draws(seed, "joint", (2,), index, CALIBRATION).tolist()
    return {
        "node_id": index + 1 if joint.node_id is None else joint.node_id,
        "bus": joint.bus,
        "format": joint.format,
        "sign": joint.sign,
        "encoder": joint.encoder,
        "torque_sensor": joint.torque != "none",
        "zero_offset_rad": joint.zero_sigma_rad * zero - joint.zero_offset_rad,
        "torque_gain": (1.0 + joint.torque_scale_sigma_ratio * scale) / joint.torque_gain,
        "torque_offset_nm": joint.torque_offset_nm / joint.torque_gain,
    }


def _described(config: Config, bus: BusConfig, joint: JointConfig) -> dict[str, Any] | None:
    """Return how a described drive speaks, with the keys of the configuration; None: tailored."""
    if joint.signals is None or joint.timing is None:
        return None
    signals = {
        role: own.model_dump(mode="json", exclude_none=True) for role, own in joint.signals.items()
    }
    path = joint.description or bus.description
    used = {own["message"] for own in signals.values()}
    keys = {key: getattr(bus, key) for key in ("sync", "listen_only", "fd")}
    return {
        "signals": signals,
        "timing": joint.timing.model_dump(mode="json", exclude_none=True),
        "description": None if path is None else str(config.resolve(path).absolute()),
        "messages": [
            own.model_dump(mode="json", exclude_defaults=True)
            for own in (bus.messages if joint.description is None else ())
            if own.name in used
        ],
        "bus": keys | (FD_RATES if bus.fd else {}),
    }


def _feed(
    config: Config, bus: BusConfig, names: list[str], world: dict[str, Any]
) -> dict[str, Any] | None:
    """Return the sender of a live feed, as the world has it where the configuration is silent."""
    if bus.feed is None:
        return None
    key = None if bus.feed.key_file is None else read_key(config.resolve(bus.feed.key_file))
    is_shared = bus.feed.clock in SHARED_CLOCKS
    return (
        {"clock_error_ppm": 0.5 * bus.feed.clock_tolerance_ppm}
        | world
        | {
            "rate_hz": bus.rate_hz,
            "source": bus.feed.source,
            "clock": bus.feed.clock,
            "clock_offset_s": UNIX_S if is_shared else world.get("clock_offset_s", 0.0),
            "key_hex": None if key is None else key.hex(),
            "order": [names.index(joint.name) for joint in config.joints],
        }
    )


def _imu(imu: ImuConfig, seed: int) -> dict[str, Any]:
    off = draws(seed, "imu", (6,), 0, CALIBRATION)
    place = np.array(imu.mounting.p_BS_m) + imu.mounting_position_sigma_m * off[:3]
    alike = ("baud_rate", "crlf", "acc_range_g", "gyro_group_delay_s", "acc_group_delay_s")
    biases = ("gyro_bias_S_rad_s", "acc_bias_S_m_s2", "gyro_matrix")
    return {key: getattr(imu, key) for key in (*alike, *biases)} | {
        "rate_hz": round(imu.rate_hz),
        "p_BS_m": place.tolist(),
        "q_BS_xyzw": turned(imu.mounting.q_BS_xyzw, imu.mounting_angle_sigma_rad * off[3:]),
    }


def _tracker(tracker: StarTrackerConfig) -> dict[str, Any]:
    alike = ("baud_rate", "rate_hz", "latency_s", "rotation")
    return {key: getattr(tracker, key) for key in alike} | {
        "p_BS_m": tracker.mounting.p_BS_m,
        "q_BS_xyzw": tracker.mounting.q_BS_xyzw,
        "subscribed": not tracker.subscribe,
    }


def _flight(scenario: Scenario, config: Config) -> dict[str, Any]:
    """Return the section `flight`: links of the world, everything else of the configuration."""
    bus = dict(scenario.flight["bus"])
    first, port = config.buses[0], min(scenario.bus_ports.values(), default=None)
    bus |= {"rate_hz": first.rate_hz, "heartbeat_s": first.heartbeat_s}
    if first.redundant is None:
        bus.pop("redundant", None)
    else:
        times = ("lost_after_s", "nodes_toggle_s")
        bus["redundant"] = bus["redundant"] | {key: getattr(first.redundant, key) for key in times}
    ports = {one.name: None if port is None else port + k for k, one in enumerate(config.buses)}
    data: dict[str, Any] = yaml.safe_load(config.source)
    return scenario.flight | {
        "bus": bus,
        "buses": {name: {"port": own} for name, own in ports.items()},
        "tick_rate_hz": config.scheduler.tick_rate_hz,
        "torque_limit_nm": max(joint.torque_limit_nm for joint in config.joints),
        "speed_limit_rad_s": max(joint.speed_limit_rad_s for joint in config.joints),
        "estimator": data.get("estimator") or {},
    }
