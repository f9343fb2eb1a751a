"""Devices of base and arm: what the general code must know of their sections."""

from collections.abc import Mapping, Sequence

from fsw.config.thrusters import ThrusterConfig
from fsw.config.wheels import WheelConfig
from fsw.config.wrench_sensors import WrenchSensorConfig

Actuator = WheelConfig | ThrusterConfig
Describable = WheelConfig  # by signals of messages
ACTUATORS = ("wheels", "thrusters")
Sampled = type[WheelConfig] | type[WrenchSensorConfig]
SAMPLED: Mapping[str, Sampled] = {  # whose samples another program may decode
    "wheels": WheelConfig,
    "wrench_sensors": WrenchSensorConfig,
}


def actuators_go_with(
    actuators: Mapping[str, Sequence[Actuator]], rates_hz: Mapping[str, float]
) -> None:
    """Raise ValueError for an actuator whose bus is not in `rates_hz` (SYNC rates), or too slow."""
    for section, parts in actuators.items():
        for i, own in enumerate(parts):
            if own.bus is not None and own.bus not in rates_hz:
                raise ValueError(
                    f"{section}.{i}.bus: {own.bus!r} is not one of the buses {sorted(rates_hz)}"
                )
            if own.bus is not None and own.rate_hz > rates_hz[own.bus]:
                raise ValueError(
                    f"{section}.{i}.rate_hz: {own.rate_hz:g} must be at most the bus's SYNC rate "
                    f"{rates_hz[own.bus]:g}"
                )
