"""Sources of devices besides the joints, by section of the configuration."""

from collections.abc import Callable, Mapping
from typing import Any

from fsw.config import BusConfig, Config
from fsw.drivers.layout.joints import layouts_of
from fsw.drivers.sources.described_sensors import SensorBusSource
from fsw.drivers.sources.samples import SampleSource, wrench_samples
from fsw.drivers.sources.thrusters import ThrusterBusSource
from fsw.drivers.sources.wheels import WheelBusSource, wheel_samples

DEVICE_SAMPLES: Mapping[str, Callable[[Any], SampleSource]] = {
    "wheels": wheel_samples,
    "wrench_sensors": wrench_samples,
}  # of samples that another program decoded
OtherSource = WheelBusSource | ThrusterBusSource | SensorBusSource


def other_sources(config: Config, bus: BusConfig) -> list[OtherSource]:
    """Return the sources besides the joints', in the order in which they receive frames."""
    found: list[OtherSource] = []
    if wheels := [(i, own) for i, own in enumerate(config.wheels) if own.bus == bus.name]:
        found.append(WheelBusSource(bus, wheels, layouts_of(config, bus, "wheels")))
    if thrusters := [(i, own) for i, own in enumerate(config.thrusters) if own.bus == bus.name]:
        found.append(ThrusterBusSource(bus, thrusters, layouts_of(config, bus, "thrusters")))
    layouts = [(own, layouts_of(config, bus, own.name)) for own in config.sensors]
    health = config.health
    return found + [SensorBusSource(bus, own, has[0], health) for own, has in layouts if has]
