"""Actuators of the base: what the general code must know of their sections."""

from fsw.config.thrusters import ThrusterConfig
from fsw.config.wheels import WheelConfig

Actuator = WheelConfig | ThrusterConfig
Describable = WheelConfig  # by signals of messages
ACTUATORS = ("wheels", "thrusters")
