"""Devices of base and arm: what the general code must know of their sections."""

from collections.abc import Mapping

from fsw.config.thrusters import ThrusterConfig
from fsw.config.wheels import WheelConfig
from fsw.config.wrench_sensors import WrenchSensorConfig

Actuator = WheelConfig | ThrusterConfig
ACTUATORS = ("wheels", "thrusters")
ON_BUS = ("joints", "imu", "star_tracker", *ACTUATORS)  # sections of devices that a bus may carry
Sampled = type[WheelConfig] | type[WrenchSensorConfig]
SAMPLED: Mapping[str, Sampled] = {  # whose samples another program may decode
    "wheels": WheelConfig,
    "wrench_sensors": WrenchSensorConfig,
}
