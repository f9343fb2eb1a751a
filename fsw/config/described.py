"""Conditions between buses and the devices on them."""

from collections.abc import Mapping, Sequence

from fsw.config.buses import BusConfig
from fsw.config.feed import SAMPLES
from fsw.config.joints import JointConfig
from fsw.config.signals import BY_SYNC, DESCRIBED, Describable


def devices_go_with(buses: Sequence[BusConfig], devices: Mapping[str, Describable]) -> None:
    """Raise ValueError for a device whose bus does not exist, or does not suit it.

    `devices`: sections of all devices with a key `bus`, by the place of each.
    """
    names = sorted(bus.name for bus in buses)
    for at, own in devices.items():
        if own.bus is not None and own.bus not in names and not _is_sensor_of_feed(own):
            raise ValueError(f"{at}.bus: {own.bus!r} is not one of the buses {names}")
    for i, bus in enumerate(buses):
        on_bus = {at: own for at, own in devices.items() if own.bus == bus.name}
        if bus.feed is None:
            _bus_suits(i, bus, on_bus)
        for at, own in on_bus.items():
            if isinstance(own, JointConfig) and own.format == "fd" and not bus.fd:
                raise ValueError(f"{at}.format: 'fd' needs buses.{bus.name}.fd: true")


def _is_sensor_of_feed(own: Describable) -> bool:
    return own.driver == SAMPLES and not isinstance(own, JointConfig)


def _bus_suits(i: int, bus: BusConfig, devices: Mapping[str, Describable]) -> None:
    """Raise ValueError for a bus that does not give its devices what they need, such as SYNC."""
    drivers = {own.driver for own in devices.values() if isinstance(own, JointConfig)}
    if len(drivers) > 1 and DESCRIBED in drivers:
        raise ValueError(f"buses.{i}.name: joints of drivers {sorted(drivers)}; must be of one")
    tailored = [at for at, own in devices.items() if own.driver == "canopen"]
    for key, value, is_bare in (
        ("sync", bus.sync, bus.sync == "none"),
        ("sync_counter_max", bus.sync_counter_max, bus.sync_counter_max == 0),
    ):
        if tailored and is_bare:
            raise ValueError(f"buses.{i}.{key}: {value!r}; {tailored[0]} needs its counter")
    for at, own in devices.items():
        if isinstance(own, JointConfig) and bus.listen_only and own.pdo != "trusted":
            raise ValueError(f"{at}.pdo: {own.pdo!r}; buses.{i}.listen_only sends nothing")
        by = "" if own.timing is None else own.timing.by
        if by in BY_SYNC and bus.sync == "none":
            raise ValueError(f"{at}.timing.by: {by!r}; buses.{i}.sync is none")
        if by == "echoed_counter" and bus.sync_counter_max == 0:
            raise ValueError(f"{at}.timing.by: {by!r}; buses.{i}.sync_counter_max is 0")
        rate_hz = getattr(own, "rate_hz", 0.0)
        if (own.driver == "canopen" or by in BY_SYNC) and rate_hz > bus.rate_hz:
            raise ValueError(
                f"{at}.rate_hz: {rate_hz:g} must be at most the bus's SYNC rate {bus.rate_hz:g}"
            )
