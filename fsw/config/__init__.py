"""The configuration: pydantic models that read YAML and raise `ConfigError`.

Every key with a dimension ends in its unit. Most keys of geometry and noise have no default. Paths
are relative to the configuration file. Reading a configuration opens no device.
"""

from fsw.config.actuators import Actuator
from fsw.config.base import (
    BodyName,
    Finite,
    NonNegative,
    Positive,
    PositiveVector3,
    Section,
    Vector3,
)
from fsw.config.buses import BusConfig, RedundantBusConfig
from fsw.config.health import HealthConfig
from fsw.config.joints import JointConfig
from fsw.config.modes import ModeConfig
from fsw.config.processing import EstimatorConfig, OrbitConfig, SchedulerConfig
from fsw.config.robot import BaseConfig, BodyConfig, BodySigma, RobotConfig
from fsw.config.sensors import ImuConfig, Mounting, StarTrackerConfig
from fsw.config.services import RecorderConfig, ServiceConfig
from fsw.config.signals import Describable
from fsw.config.telemetry import TelemetryConfig
from fsw.config.whole import BusDevice, Config, load, parse
from fsw.config.wrench_sensors import WrenchSensorConfig

__all__ = [
    "Actuator",
    "BaseConfig",
    "BodyConfig",
    "BodyName",
    "BodySigma",
    "BusConfig",
    "BusDevice",
    "Config",
    "Describable",
    "EstimatorConfig",
    "Finite",
    "HealthConfig",
    "ImuConfig",
    "JointConfig",
    "ModeConfig",
    "Mounting",
    "NonNegative",
    "OrbitConfig",
    "Positive",
    "PositiveVector3",
    "RecorderConfig",
    "RedundantBusConfig",
    "RobotConfig",
    "SchedulerConfig",
    "Section",
    "ServiceConfig",
    "StarTrackerConfig",
    "TelemetryConfig",
    "Vector3",
    "WrenchSensorConfig",
    "load",
    "parse",
]
