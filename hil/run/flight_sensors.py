"""Sections of the flight configuration for joints, inertial unit and star tracker."""

import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hil.devices.described import is_node_file, steps_of
from hil.devices.dialects import Dialect, dialect_of
from hil.devices.imu_wire import wire_of
from hil.judge.bound import Sensors
from hil.judge.unknown_motion import Encoders
from hil.world.noise import BandLimitedWhiteNoise
from hil.world.scenario import Scenario, ScenarioError
from hil.world.sensor_config import ImuSensorConfig, JointSensorConfig, NodeConfig, SensorConfig
from hil.world.sensors import rotation_of

FIRST_NODE_ID = 0x11
PLAIN = NodeConfig(node_id=FIRST_NODE_ID)
TORQUE_STEP_NM = {"classic": 1e-2, "fd": 1e-4}  # wire resolution of joint nodes
POSITION_STEP_RAD = 2 * math.pi / 2**24
OF_METRES = (("torque", "force"), ("_nms_rad", "_ns_m"), ("_rad", "_m"), ("_nm", "_n"))  # in keys


def _nodes(sensors: SensorConfig, n: int) -> tuple[NodeConfig, ...]:
    """Return the n joint nodes, base to tool; default nodes if the sensors name none.

    Raises
    ------
    ScenarioError if the sensors name another number of nodes than n.
    """
    default = tuple(NodeConfig(node_id=FIRST_NODE_ID + i) for i in range(n))
    nodes = sensors.joints.nodes or default
    if len(nodes) != n:
        raise ScenarioError(f"sensors.joints.nodes: {len(nodes)} nodes for {n} joints")
    return nodes


def joint_sections(
    sensors: SensorConfig,
    flight: Mapping[str, Any],
    names: Sequence[str],
    sliding: Collection[str],
    begin_rad: Sequence[float],
    stamp_noise_rad: float,
) -> list[dict[str, Any]]:
    """Return the section `joints`, base to tool; only speed encoders use `begin_rad`.

    `sliding` : names of the prismatic joints

    Raises
    ------
    ScenarioError if the sensors name another number of nodes than joints.
    """
    rate_hz = float(flight["bus"]["rate_hz"])
    return [
        _in_units_of(
            {
                "name": name,
                "bus": node.bus,
                **_driver(sensors.joints, node),
                "sign": node.sign,
                "speed_limit_rad_s": flight["speed_limit_rad_s"],
                **_angle(
                    sensors.joints, node, start_rad, stamp_noise_rad, rate_hz, name in sliding
                ),
                **_torque(sensors.joints, node, flight),
            },
            is_prismatic=name in sliding,
        )
        for name, node, start_rad in zip(names, _nodes(sensors, len(names)), begin_rad, strict=True)
    ]


def _driver(joints: JointSensorConfig, node: NodeConfig) -> dict[str, Any]:
    """Return the keys of a joint that say how it is read: from the CAN bus, or in a feed."""
    if joints.feed is not None:
        return {"driver": "samples"}
    dialect, own = own_dialect(joints), node.described
    if own is not None:
        keys: dict[str, Any] = {"driver": "described"}
        keys |= {"signals": dict(own.signals), "timing": dict(own.timing)}
        if is_node_file(own):
            keys |= {"node_id": node.node_id, "description": str(own.description)}
        return keys
    if dialect is None:
        return {"node_id": node.node_id, "format": node.format}
    return {"driver": "described", **dialect.joint(node.node_id)}


def own_dialect(joints: JointSensorConfig) -> Dialect | None:
    """Return the dialect of the drives; None: the tailored format.

    Raises
    ------
    ScenarioError if there is no such dialect.
    """
    try:
        return None if joints.dialect is None else dialect_of(joints.dialect)
    except ValueError as error:
        raise ScenarioError(f"sensors.{error}") from error


def has_fd(joints: JointSensorConfig, bus: str) -> bool:
    """Return whether nodes of a bus send frames of CAN FD."""
    dialect = own_dialect(joints)
    own = [node for node in joints.nodes if node.bus == bus]
    described = [node.described for node in own if node.described is not None]
    return (
        any(node.format == "fd" for node in own)
        or any(drive.fd for drive in described)
        or (dialect is not None and bool(dialect.bus.get("fd")))
    )


def foreign_bus(sensors: SensorConfig, bus: str, n: int) -> dict[str, Any]:
    """Return the keys of a bus whose drives are of other makers; none: of tailored ones."""
    dialect = own_dialect(sensors.joints)
    own = [node for node in _nodes(sensors, n) if node.bus == bus]
    described = [node.described for node in own if node.described is not None]
    if described:
        first, used = described[0], {m["name"]: dict(m) for d in described for m in d.messages}
        keys = {**first.bus, "messages": list(used.values())}
        if first.description is not None and not is_node_file(first):
            keys["description"] = str(first.description)
        return keys
    if dialect is None:
        return {}
    nodes = [node.node_id for node in own]
    messages = [dict(message) for node in nodes for message in dialect.messages(node)]
    return {**dialect.bus, "messages": messages}


def _steps(joints: JointSensorConfig, node: NodeConfig) -> tuple[float, float]:
    """Return the resolution of position [rad] and torque [N m] on the wire."""
    dialect = own_dialect(joints)
    if node.described is not None:
        return steps_of(node.node_id, node.described)
    if dialect is not None:
        return dialect.position_step_rad, dialect.torque_step_nm
    if joints.feed is not None:
        return 0.0, 0.0
    return POSITION_STEP_RAD, TORQUE_STEP_NM[node.format]


def torque_noise_nm(joints: JointSensorConfig, node: NodeConfig, rate_hz: float) -> float:
    """Return 1 sigma of one torque sample [N m], including rounding on the wire."""
    sigma = _sigma(joints.torque_noise, rate_hz, joints.torque_noise_nm)
    _, step_nm = _steps(joints, node)
    return math.hypot(sigma, step_nm / math.sqrt(12))


def _sigma(noise: BandLimitedWhiteNoise | None, rate_hz: float, otherwise: float) -> float:
    return otherwise if noise is None else noise.sigma(rate_hz)


def position_noise_rad(
    joints: JointSensorConfig,
    stamp_noise_rad: float = 0.0,
    rate_hz: float = 500.0,
    *,
    node: NodeConfig = PLAIN,
    is_prismatic: bool = False,
) -> float:
    """Return 1 sigma of one position sample: noise, encoder step, wire step, time-stamp noise."""
    encoder = 2 * math.pi / 2**joints.encoder_bits
    wire, _ = _steps(joints, node)
    step = math.hypot(encoder, wire) / math.sqrt(12)
    step /= math.tau if is_prismatic else 1.0
    noise = _sigma(joints.position_noise, rate_hz, joints.encoder_noise_rad)
    return math.hypot(noise, step, stamp_noise_rad)


def speed_noise_rad_s(joints: JointSensorConfig, *, is_prismatic: bool = False) -> float:
    """Return 1 sigma of one sample of a speed encoder: noise and wire step."""
    step = POSITION_STEP_RAD / (math.tau if is_prismatic else 1.0)
    return math.hypot(joints.speed_noise_rad_s, step / math.sqrt(12))


def _in_units_of(joint: dict[str, Any], *, is_prismatic: bool) -> dict[str, Any]:
    """Return a joint's section; for a prismatic joint, rename keys to metres and newtons."""
    if not is_prismatic:
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
    is_prismatic: bool,
) -> dict[str, Any]:
    """Return the encoder's keys of a joint's section; `start_rad` is the declared start angle."""
    if node.encoder == "speed":
        return {
            "encoder": "speed",
            "speed_noise_rad_s": speed_noise_rad_s(joints, is_prismatic=is_prismatic),
            "start_rad": start_rad,
            "zero_sigma_rad": joints.start_sigma_rad,
        }
    return {
        "zero_offset_rad": -node.zero_offset_rad,  # flight: sign x reading - offset
        "position_noise_rad": position_noise_rad(
            joints, stamp_noise_rad, rate_hz, node=node, is_prismatic=is_prismatic
        ),
        "zero_sigma_rad": 0.0,
    }


def _torque(
    joints: JointSensorConfig, node: NodeConfig, flight: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the torque sensor's keys of a joint's section."""
    if not node.torque_sensor:
        return {"torque": "none"}
    friction = {
        "friction_coulomb_sigma_nm": joints.friction_coulomb_sigma_nm,
        "friction_viscous_sigma_nms_rad": joints.friction_viscous_sigma_nms_rad,
    }
    keys: dict[str, Any] = {key: sigma for key, sigma in friction.items() if sigma > 0.0}
    if joints.torque == "motor_current":
        keys |= {
            "torque": joints.torque,
            "torque_scale_sigma_ratio": joints.torque_scale_error_ratio,
            "friction_load_sigma_ratio": 0.0,  # this world's gears have none
            "rotor_inertia_sigma_kg_m2": joints.rotor_inertia_sigma_kg_m2,
            "ripple_sigma_nm": joints.ripple_sigma_nm,
            "ripple_periods": list(joints.ripple_periods),
        }
    return {
        "torque_gain": 1.0 / node.torque_gain,
        "torque_offset_nm": node.torque_offset_nm / node.torque_gain,
        "torque_limit_nm": flight["torque_limit_nm"],
        "torque_noise_nm": torque_noise_nm(joints, node, float(flight["bus"]["rate_hz"])),
        "torque_offset_sigma_nm": joints.torque_offset_sigma_nm,
        "torque_scale_sigma_ratio": 0.0,
        **keys,
    }


def _gyro_sigma(imu: ImuSensorConfig) -> float:
    """Return 1 sigma of one rate sample [rad/s]."""
    white = imu.angle_random_walk_rad_sqrt_s * math.sqrt(imu.rate_hz)
    return _sigma(imu.gyro_noise, imu.rate_hz, white)


def _acc_sigma(imu: ImuSensorConfig) -> float:
    """Return 1 sigma of one acceleration sample [m/s^2]."""
    white = imu.velocity_random_walk_m_s_sqrt_s * math.sqrt(imu.rate_hz)
    return _sigma(imu.acc_noise, imu.rate_hz, white)


def imu_section(sensors: SensorConfig, folder: Path) -> dict[str, Any]:
    """Return the section `imu`; its port is a serial line of the plant in `folder`."""
    imu = sensors.imu
    if imu is None:
        raise ScenarioError("sensors.imu: missing; only a clamped base does without one")
    try:
        wire = wire_of(imu)
    except ValueError as error:
        raise ScenarioError(str(error)) from error
    wait_s = 0.0 if wire.has_latency else imu.latency_s  # declared where no datagram has it
    return {
        "driver": wire.driver,
        "options": dict(wire.options),
        "port": str(folder.absolute() / "imu"),
        "baud_rate": imu.baud_rate,
        "rate_hz": float(imu.rate_hz),
        "crlf": imu.crlf,
        "acc_range_g": imu.acc_range_g,
        "mounting": {"p_BS_m": list(imu.p_BS_m), "q_BS_xyzw": list(imu.q_BS_xyzw)},
        "gyro_group_delay_s": imu.gyro_group_delay_s + wait_s,
        "acc_group_delay_s": imu.acc_group_delay_s + wait_s,
        "angle_random_walk_rad_sqrt_s": _gyro_sigma(imu) / math.sqrt(imu.rate_hz),
        "velocity_random_walk_m_s_sqrt_s": _acc_sigma(imu) / math.sqrt(imu.rate_hz),
        "gyro_bias_S_rad_s": list(imu.gyro_bias_S_rad_s),
        "acc_bias_S_m_s2": list(imu.acc_bias_S_m_s2),
        "gyro_matrix": [list(row) for row in imu.gyro_matrix],
        "mounting_position_sigma_m": 0.0,
        "mounting_angle_sigma_rad": 0.0,
        "gyro_bias_sigma_rad_s": imu.gyro_bias_sigma_rad_s,
        "acc_bias_sigma_m_s2": imu.acc_bias_sigma_m_s2,
    }


def star_tracker_section(sensors: SensorConfig, folder: Path) -> dict[str, Any]:
    """Return the section `star_tracker`, empty without a tracker; the port is in `folder`."""
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


def bound_sensors(scenario: Scenario, n: int) -> Sensors:
    """Return the sensors' white noise at their native rates, without rounding on the wire."""
    sensors = SensorConfig.from_dict(scenario.sensors)
    imu = sensors.imu
    rate_hz = float(scenario.flight["bus"]["rate_hz"])
    senses = [node.torque_sensor for node in _nodes(sensors, n)]
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
        torque_scale_sigma=sensors.joints.torque_scale_error_ratio,
        momentum_sigma_nms=scenario.flight["estimator"].get("momentum_sigma_nms", 0.0),
    )


def bound_encoders(scenario: Scenario, is_prismatic: Sequence[bool]) -> Encoders:
    """Return the noise of the joints' encoders, rounding included, and the motion's smoothness."""
    sensors = SensorConfig.from_dict(scenario.sensors)
    rate_hz, joints = float(scenario.flight["bus"]["rate_hz"]), sensors.joints
    nodes = _nodes(sensors, len(is_prismatic))
    by_speed = np.array([node.encoder == "speed" for node in nodes])
    angles = [
        position_noise_rad(joints, 0.0, rate_hz, node=node, is_prismatic=own)
        for node, own in zip(nodes, is_prismatic, strict=True)
    ]
    speeds = [speed_noise_rad_s(joints, is_prismatic=own) for own in is_prismatic]
    return Encoders(
        rate_hz=rate_hz,
        angle_noise_rad=np.where(by_speed, np.inf, angles),
        speed_noise_rad_s=np.where(by_speed, speeds, np.inf),
        start_sigma_rad=np.where(by_speed, joints.start_sigma_rad, np.inf),
    )
