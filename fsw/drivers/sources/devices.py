"""Sources of devices of the base and of wrench sensors, by section of the configuration."""

from collections.abc import Callable, Mapping
from typing import Any

from fsw.config import BusConfig, Config
from fsw.drivers.layout.joints import layouts_of
from fsw.drivers.sources.samples import SampleSource, wrench_samples
from fsw.drivers.sources.thrusters import ThrusterBusSource
from fsw.drivers.sources.wheels import WheelBusSource, wheel_samples

DEVICE_SAMPLES: Mapping[str, Callable[[Any], SampleSource]] = {
    "wheels": wheel_samples,
    "wrench_sensors": wrench_samples,
}  # of samples that another program decoded
ActuatorSource = WheelBusSource | ThrusterBusSource


def actuator_sources(config: Config, bus: BusConfig) -> list[ActuatorSource]:
    """Return the sources in the order in which they take frames of the bus."""
    wheels = [(i, own) for i, own in enumerate(config.wheels) if own.bus == bus.name]
    thrusters = [(i, own) for i, own in enumerate(config.thrusters) if own.bus == bus.name]
    layouts = layouts_of(config, bus, "wheels")
    found: list[ActuatorSource] = [WheelBusSource(bus, wheels, layouts)] if wheels else []
    return found + ([ThrusterBusSource(bus, thrusters)] if thrusters else [])
