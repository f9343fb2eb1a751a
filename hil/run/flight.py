"""The files of the flight side: configuration and robot, with no truth of an unknown body."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hil.judge.bound import Sensors
from hil.world.base_urdf import replace_base
from hil.world.environment.config import OrbitSection
from hil.world.environment.orbit import Orbit
from hil.world.inertia import FloatArray
from hil.world.noise import BandLimitedWhiteNoise
from hil.world.robot import Robot
from hil.world.scenario import Prior, Scenario, ScenarioError, mapping_from
from hil.world.sensors import (
    ImuSensorConfig,
    JointSensorConfig,
    NodeConfig,
    SensorConfig,
    ThrusterSensorConfig,
    WheelSensorConfig,
    generator,
    rotation_of,
)
from hil.world.springs import Panel, Sprung
from hil.world.thrusters import ThrusterSystem
from hil.world.wheels import WheelSystem

FIRST_NODE_ID = 0x11
URDF = "robot.urdf"
TORQUE_STEP_NM = {"classic": 1e-2, "fd": 1e-4}  # wire resolution of the joint nodes
POSITION_STEP_RAD = 2 * math.pi / 2**24
OF_METRES = (("torque", "force"), ("_nms_rad", "_ns_m"), ("_rad", "_m"), ("_nm", "_n"))  # in keys


def nodes_of(sensors: SensorConfig, n: int) -> tuple[NodeConfig, ...]:
    """Return the joint nodes, base to tool.

    Raises
    ------
    ScenarioError if their number is not the robot's.
    """
    default = tuple(NodeConfig(node_id=FIRST_NODE_ID + i) for i in range(n))
    nodes = sensors.joints.nodes or default
    if len(nodes) != n:
        raise ScenarioError(f"sensors.joints.nodes: {len(nodes)} nodes for {n} joints")
    return nodes


def torque_noise_nm(joints: JointSensorConfig, node: NodeConfig, rate_hz: float) -> float:
    """Return 1 sigma of one torque sample with the wire's rounding."""
    sigma = _sigma(joints.torque_noise, rate_hz, joints.torque_noise_nm)
    return math.hypot(sigma, TORQUE_STEP_NM[node.format] / math.sqrt(12))


def _sigma(noise: BandLimitedWhiteNoise | None, rate_hz: float, otherwise: float) -> float:
    return otherwise if noise is None else noise.sigma(rate_hz)


def position_noise_rad(
    joints: JointSensorConfig,
    stamp_noise_rad: float = 0.0,
    rate_hz: float = 500.0,
    *,
    is_prismatic: bool = False,
) -> float:
    """Return 1 sigma of one position sample: noise, encoder step, wire step, uncertain stamp."""
    encoder = 2 * math.pi / 2**joints.encoder_bits
    step = math.hypot(encoder, POSITION_STEP_RAD) / math.sqrt(12)
    step /= math.tau if is_prismatic else 1.0
    noise = _sigma(joints.position_noise, rate_hz, joints.encoder_noise_rad)
    return math.hypot(noise, step, stamp_noise_rad)


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
    """Return the flight configuration: data sheets, mounting, known bodies, priors of the others.

    The truth's arm and calibration are what the robot file and the scenario say: told as exact.
    The real-time plant makes its serial lines in `folder`; `overrides` are for the estimator;
    `stamp_noise_rad` is what the jitter of a SYNC stamp taken by software adds to the positions;
    `start_rad` are the joints' angles where the motion begins, zero by default; `seed` fixes the
    errors of wheels' inertias, thrusters, modes and angles at the start in it; None:
    nothing errs.
    """
    sensors = SensorConfig.from_dict(scenario.sensors)
    flight = scenario.flight
    rate_hz = float(flight["bus"]["rate_hz"])
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
    nodes = nodes_of(sensors, len(joint_names))
    begin = [
        angle + sensors.joints.start_sigma_rad * float(_draws(seed, "joint", (), i, 4))
        for i, angle in enumerate(start_rad or [0.0] * len(nodes))
    ]
    joints = [
        _in_units_of(
            node,
            {
                "name": name,
                "bus": node.bus,
                "node_id": node.node_id,
                "format": node.format,
                "sign": node.sign,
                "speed_limit_rad_s": flight["speed_limit_rad_s"],
                **_angle(sensors.joints, node, begin[i], stamp_noise_rad, rate_hz),
                **_torque(sensors.joints, node, flight),
            },
        )
        for i, (name, node) in enumerate(zip(joint_names, nodes, strict=True))
    ]
    document: dict[str, Any] = {
        "robot": {"urdf": URDF, "tool_frame": scenario.tool_frame, "links_sigma_ratio": 0.0},
        "bodies": bodies,
        "unknown": list(scenario.unknown),
        "buses": [
            {
                "name": name,
                **settings,
                "port": bus_ports.get(name),
                "fd": any(joint["format"] == "fd" for joint in joints if joint["bus"] == name),
                "sync": "producer",
                "sync_counter_max": sensors.joints.sync_counter_max,
                "latch_offset_s": sensors.joints.latch_offset_s,
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
        document["wheels"] = _wheels(scenario.wheels, sensors.wheels, seed)
    if scenario.thrusters is not None and sensors.thrusters is not None:
        document["thrusters"] = _thrusters(scenario.thrusters, sensors.thrusters, seed)
    document |= _excitation(flight)
    if flight.get("modes"):
        document["modes"] = _modes(scenario, flight["modes"], seed)
    if sensors.star_tracker is not None:
        document["star_tracker"] = _star_tracker(sensors, folder)
    stand = scenario.stand
    if sensors.imu is not None or stand is None or stand.motion != "clamped":
        document["imu"] = _imu(sensors, folder)
    if stand is not None:
        gravity = list(stand.gravity_m_s2)
        document["base"] = {"motion": stand.motion, "gravity_B_m_s2": gravity}
    environment = scenario.environment
    if environment is not None and environment.told_to_flight and environment.gravity_gradient:
        document["orbit"] = _orbit(environment.orbit, scenario.before_s)
    return document


def _in_units_of(node: NodeConfig, joint: dict[str, Any]) -> dict[str, Any]:
    """Return a joint's keys, those of a prismatic one in metres and newtons."""
    if not node.is_prismatic:
        return joint
    named = {"kind": "prismatic"}
    for key, value in joint.items():
        name = key
        for word, other in OF_METRES:
            name = name.replace(word, other)
        named[name] = value
    return named


def _angle(
    joints: JointSensorConfig,
    node: NodeConfig,
    start_rad: float,
    stamp_noise_rad: float,
    rate_hz: float,
) -> dict[str, Any]:
    """Return what the flight side knows of a node's encoder; it begins at `start_rad`, as told."""
    if node.encoder == "speed":
        step = POSITION_STEP_RAD / (math.tau if node.is_prismatic else 1.0)
        return {
            "encoder": "speed",
            "speed_noise_rad_s": math.hypot(joints.speed_noise_rad_s, step / math.sqrt(12)),
            "start_rad": start_rad,
            "zero_sigma_rad": joints.start_sigma_rad,
        }
    return {
        "zero_offset_rad": -node.zero_offset_rad,  # flight: sign x reading - offset
        "position_noise_rad": position_noise_rad(
            joints, stamp_noise_rad, rate_hz, is_prismatic=node.is_prismatic
        ),
        "zero_sigma_rad": 0.0,
    }


def _torque(
    joints: JointSensorConfig, node: NodeConfig, flight: Mapping[str, Any]
) -> dict[str, Any]:
    """Return what the flight side knows of a node's torque sensor."""
    if not node.torque_sensor:
        return {"torque": "none"}
    friction = {
        "friction_coulomb_sigma_nm": joints.friction_coulomb_sigma_nm,
        "friction_viscous_sigma_nms_rad": joints.friction_viscous_sigma_nms_rad,
    }
    return {
        "torque_limit_nm": flight["torque_limit_nm"],
        "torque_noise_nm": torque_noise_nm(joints, node, float(flight["bus"]["rate_hz"])),
        "torque_offset_sigma_nm": joints.torque_offset_sigma_nm,
        "torque_scale_sigma_ratio": 0.0,
        **{key: sigma for key, sigma in friction.items() if sigma > 0.0},
    }


def _draws(
    seed: int | None, device: str, shape: tuple[int, ...], index: int = 0, stream: int = 0
) -> FloatArray:
    """Return unit draws of what is declared wrong; zeros without a seed."""
    if seed is None:
        return np.zeros(shape)
    return np.asarray(generator(seed, device, index, stream).standard_normal(shape))


def _wheels(
    system: WheelSystem, sensors: WheelSensorConfig, seed: int | None
) -> list[dict[str, Any]]:
    """Return the section `wheels`; each inertia errs by its sigma."""
    if len(sensors.nodes) != len(system.rotors):
        raise ScenarioError(
            f"sensors.wheels.nodes: {len(sensors.nodes)} nodes for {len(system.rotors)} wheels"
        )
    off = _draws(seed, "wheel", (len(system.rotors),), len(system.rotors))
    torque: dict[str, Any] = {"torque": "none"}
    if sensors.torque_used:
        torque = {"torque": "measured", "torque_noise_nm": sensors.torque_noise_nm}
    return [
        {
            "name": f"wheel{k + 1}",
            "bus": node.bus,
            "node_id": node.node_id,
            "rate_hz": sensors.rate_hz,
            "axis_B": rotor.unit.tolist(),
            "inertia_kg_m2": rotor.inertia_kg_m2
            / (1.0 + system.inertia_sigma_ratio * float(off[k])),
            "inertia_sigma_ratio": system.inertia_sigma_ratio,
            "speed_limit_rad_s": 1.1 * system.speed_limit_rad_s,
            "speed_noise_rad_s": sensors.speed_noise_rad_s,
            "torque_limit_nm": 1.1 * system.torque_limit_nm,
            **torque,
        }
        for k, (node, rotor) in enumerate(zip(sensors.nodes, system.rotors, strict=True))
    ]


def _thrusters(
    system: ThrusterSystem, sensors: ThrusterSensorConfig, seed: int | None
) -> list[dict[str, Any]]:
    """Return the section `thrusters`; force, delay and rise time err by their sigmas."""
    off = _draws(seed, "thruster", (4, len(system.jets)))
    force = system.force_sigma_ratio * math.sqrt(0.5) * (off[0, 0] + off[1])
    delay_s = np.maximum(system.delay_s - system.delay_sigma_s * off[2], 0.0)
    rise_s = np.maximum(system.rise_s - system.rise_sigma_s * off[3], 0.1 * system.rise_s)
    return [
        {
            "name": f"thruster{k + 1}",
            "bus": sensors.bus,
            "node_id": sensors.node_id,
            "valve": k,
            "rate_hz": sensors.rate_hz,
            "p_B_m": list(jet.place_m),
            "direction_B": jet.unit.tolist(),
            "force_n": jet.force_n / (1.0 + float(force[k])),
            "force_sigma_ratio": system.force_sigma_ratio,
            "delay_s": float(delay_s[k]),
            "delay_sigma_s": system.delay_sigma_s,
            "rise_s": float(rise_s[k]),
            "rise_sigma_s": system.rise_sigma_s,
        }
        for k, jet in enumerate(system.jets)
    ]


def _excitation(flight: Mapping[str, Any]) -> dict[str, Any]:
    own = flight.get("excitation")
    return {"excitation": own | {"limits": str(Path(own["limits"]).resolve())}} if own else {}


def _modes(scenario: Scenario, told: Mapping[str, Any], seed: int | None) -> list[dict[str, Any]]:
    """Return the section `modes`; mass, frequency and damping of each err by their sigmas."""
    parts: tuple[Sprung, ...] = (*scenario.slosh, *scenario.panels)
    kinds = ("mass", "frequency", "damping")
    sigma = np.array([told[f"{kind}_sigma_ratio"] for kind in kinds])
    off = _draws(seed, "mode", (len(parts), len(kinds)), len(parts)) * sigma
    modes = []
    for k, (part, (mass, frequency, damping)) in enumerate(zip(parts, off.tolist(), strict=True)):
        mode: dict[str, Any] = {
            "name": f"mode{k + 1}",
            "kind": "slosh",
            "p_B_m": list(part.place_m),
            "axes_B": [(np.array(axis) / np.linalg.norm(axis)).tolist() for axis in part.axes],
            "mass_kg": part.mass_kg / (1.0 + mass),
            "frequency_hz": part.frequency_hz * math.exp(-frequency),
            "damping_ratio": part.damping_ratio * math.exp(-damping),
            **{f"{kind}_sigma_ratio": told[f"{kind}_sigma_ratio"] for kind in kinds},
        }
        if isinstance(part, Panel):
            inertia = [value / (1.0 + mass) for value in part.inertia_kg_m2]
            mode |= {"kind": "panel", "com_m": list(part.com_m), "inertia_kg_m2": inertia}
            mode["amplitude_rad"] = told["amplitude_rad"]
        else:
            mode["amplitude_m"] = told["amplitude_m"]
        modes.append(mode)
    return modes


def _orbit(section: OrbitSection, before_s: float) -> dict[str, Any]:
    """Return the orbit's state at the first SYNC, `before_s` before the motion."""
    orbit = Orbit.from_section(section)
    return {
        "position_m": orbit.position_m(-before_s).tolist(),
        "velocity_m_s": orbit.velocity_m_s(-before_s).tolist(),
    }


def _gyro_sigma(imu: ImuSensorConfig) -> float:
    """Return 1 sigma of one rate sample [rad/s]."""
    white = imu.angle_random_walk_rad_sqrt_s * math.sqrt(imu.rate_hz)
    return _sigma(imu.gyro_noise, imu.rate_hz, white)


def _acc_sigma(imu: ImuSensorConfig) -> float:
    """Return 1 sigma of one acceleration sample [m/s^2]."""
    white = imu.velocity_random_walk_m_s_sqrt_s * math.sqrt(imu.rate_hz)
    return _sigma(imu.acc_noise, imu.rate_hz, white)


def _imu(sensors: SensorConfig, folder: Path) -> dict[str, Any]:
    imu = sensors.imu
    if imu is None:
        raise ScenarioError("sensors.imu: missing; only a clamped base does without one")
    return {
        "port": str(folder.absolute() / "imu"),
        "baud_rate": imu.baud_rate,
        "rate_hz": float(imu.rate_hz),
        "crlf": imu.crlf,
        "acc_range_g": imu.acc_range_g,
        "mounting": {"p_BS_m": list(imu.p_BS_m), "q_BS_xyzw": list(imu.q_BS_xyzw)},
        "gyro_group_delay_s": imu.gyro_group_delay_s,
        "acc_group_delay_s": imu.acc_group_delay_s,
        "angle_random_walk_rad_sqrt_s": _gyro_sigma(imu) / math.sqrt(imu.rate_hz),
        "velocity_random_walk_m_s_sqrt_s": _acc_sigma(imu) / math.sqrt(imu.rate_hz),
        "mounting_position_sigma_m": 0.0,
        "mounting_angle_sigma_rad": 0.0,
        "gyro_bias_sigma_rad_s": imu.gyro_bias_sigma_rad_s,
        "acc_bias_sigma_m_s2": imu.acc_bias_sigma_m_s2,
    }


def _star_tracker(sensors: SensorConfig, folder: Path) -> dict[str, Any]:
    tracker = sensors.star_tracker
    if tracker is None:
        return {}
    noise = tracker.attitude_noise
    return {
        "port": str(folder.absolute() / "star_tracker"),
        "baud_rate": tracker.baud_rate,
        "rate_hz": tracker.rate_hz,
        "mounting": {"p_BS_m": list(tracker.p_BS_m), "q_BS_xyzw": list(tracker.q_BS_xyzw)},
        "time": "arrival",
        "latency_s": tracker.latency_s,
        "rotation": tracker.rotation,
        "noise_across_rad": _sigma(noise, tracker.rate_hz, tracker.noise_across_rad),
        "noise_about_rad": _sigma(noise, tracker.rate_hz, tracker.noise_about_rad),
        "subscribe": not tracker.subscribed,
    }


def on_socketcan(scenario: Scenario) -> Scenario:
    """Return the scenario with its buses on vcan0 and on, a redundant one behind them."""
    bus = {key: value for key, value in scenario.flight["bus"].items() if key != "port"}
    bus |= {"interface": "socketcan", "channel": "vcan0"}
    several = enumerate(scenario.flight.get("buses") or ())
    buses = {name: {"channel": f"vcan{k}"} for k, name in several}
    if bus.get("redundant") is not None:
        second = {key: value for key, value in bus["redundant"].items() if key != "port"}
        bus["redundant"] = second | {"channel": f"vcan{max(1, len(buses))}"}
    return replace(scenario, flight=scenario.flight | {"bus": bus, "buses": buses})


def on_frames(scenario: Scenario) -> Scenario:
    """Return the scenario with struct can_frame in its datagrams, as a socket of SocketCAN has."""
    bus = scenario.flight["bus"] | {"interface": "udp_frames"}
    return replace(scenario, flight=scenario.flight | {"bus": bus})


def write_flight(
    folder: Path, scenario: Scenario, priors: Mapping[str, Prior], document: Mapping[str, Any]
) -> Path:
    """Write the flight configuration and the robot file it names; return the former's path."""
    folder.mkdir(parents=True, exist_ok=True)
    base: FloatArray = priors["base"].report if "base" in priors else scenario.truth["base"]
    (folder / URDF).write_text(replace_base(scenario.urdf, base), encoding="utf-8")
    return write_yaml(folder / "flight.yaml", document)


def write_yaml(path: Path, document: Mapping[str, Any]) -> Path:
    """Write a YAML file; return its path."""
    text = yaml.safe_dump(dict(document), sort_keys=False, default_flow_style=None, width=100)
    path.write_text(text, encoding="utf-8")
    return path


def bound_sensors(scenario: Scenario, n: int) -> Sensors:
    """Return the raw sensors' white noise at native rates; rounding of the wire is not in it."""
    sensors = SensorConfig.from_dict(scenario.sensors)
    imu = sensors.imu
    rate_hz = float(scenario.flight["bus"]["rate_hz"])
    senses = [node.torque_sensor for node in nodes_of(sensors, n)]
    torque_nm = _sigma(sensors.joints.torque_noise, rate_hz, sensors.joints.torque_noise_nm)
    return Sensors(
        joint_rate_hz=rate_hz,
        torque_noise_nm=np.where(senses, torque_nm, np.inf),
        torque_offset_sigma_nm=np.full(n, sensors.joints.torque_offset_sigma_nm),
        imu_rate_hz=1.0 if imu is None else float(imu.rate_hz),
        gyro_noise_rad_s=np.inf if imu is None else _gyro_sigma(imu),
        gyro_bias_sigma_rad_s=0.0 if imu is None else imu.gyro_bias_sigma_rad_s,
        acc_noise_m_s2=np.inf if imu is None else _acc_sigma(imu),
        acc_bias_sigma_m_s2=0.0 if imu is None else imu.acc_bias_sigma_m_s2,
        p_BS_m=np.zeros(3) if imu is None else np.array(imu.p_BS_m),
        R_BS=np.eye(3) if imu is None else rotation_of(imu.q_BS_xyzw),
    )


def joint_names(scenario: Scenario) -> tuple[str, ...]:
    """Return the robot's joints from base to tool."""
    return Robot.load(scenario.urdf, scenario.tool_frame).joint_names
