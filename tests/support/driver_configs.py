"""Device configurations for the drivers' tests."""

from typing import Any

from fsw.config import BusConfig, ImuConfig, JointConfig, Mounting, StarTrackerConfig

LEVEL = Mounting(p_BS_m=(0.0, 0.0, 0.0), q_BS_xyzw=(0.0, 0.0, 0.0, 1.0))


def imu_config(**changes: Any) -> ImuConfig:
    data: dict[str, Any] = {
        "port": "imu",
        "rate_hz": 500.0,
        "mounting": LEVEL,
        "gyro_group_delay_s": 0.0022,
        "acc_group_delay_s": 0.0063,
        "angle_random_walk_rad_sqrt_s": 4e-5,
        "velocity_random_walk_m_s_sqrt_s": 1e-3,
        "gyro_bias_sigma_rad_s": 0.0,
        "acc_bias_sigma_m_s2": 0.0,
    }
    return ImuConfig(**(data | changes))


def star_tracker_config(**changes: Any) -> StarTrackerConfig:
    data: dict[str, Any] = {
        "port": "star_tracker",
        "rate_hz": 10.0,
        "mounting": LEVEL,
        "latency_s": 0.1,
        "noise_across_rad": 1e-5,
        "noise_about_rad": 5e-5,
    }
    return StarTrackerConfig(**(data | changes))


def bus_config(**changes: Any) -> BusConfig:
    data: dict[str, Any] = {
        "name": "arm",
        "interface": "virtual",
        "channel": "arm",
        "rate_hz": 500.0,
    }
    return BusConfig(**(data | changes))


def joint_config(node_id: int, **changes: Any) -> JointConfig:
    data: dict[str, Any] = {
        "name": f"j{node_id}",
        "bus": "arm",
        "node_id": node_id,
        "torque_limit_nm": 100.0,
        "speed_limit_rad_s": 2.0,
        "torque_noise_nm": 0.1,
        "torque_offset_sigma_nm": 0.1,
        "position_noise_rad": 1e-6,
    }
    return JointConfig(**(data | changes))


def unit_on_bus(data: dict[str, Any]) -> None:
    """Put the inertial unit of a configuration on its first bus: six signals of one message."""
    axes = [f"{role}_{axis}" for role in ("rate", "force") for axis in "xyz"]
    fields = [
        {"name": name, "start": 8 * k, "bits": 8, "number": "signed"}
        | {"unit": "rad/s" if k < 3 else "m/s^2"}
        for k, name in enumerate(axes)
    ]
    data["buses"][0]["messages"] = [{"name": "unit", "id": 0x300, "length": 6, "signals": fields}]
    data["imu"] |= {"driver": "described", "bus": data["buses"][0]["name"], "port": None}
    data["imu"] |= {"signals": {name: {"message": "unit", "signal": name} for name in axes}}
    data["imu"] |= {"timing": {"by": "arrival", "sigma_s": 1e-4}}
