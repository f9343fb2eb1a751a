"""Conditions between the feeds of a configuration and the devices on them."""

from collections.abc import Mapping, Sequence

from fsw.config.actuators import Actuator
from fsw.config.buses import BusConfig
from fsw.config.feed import SAMPLES
from fsw.config.joints import JointConfig
from fsw.config.sensors import ImuConfig, StarTrackerConfig
from fsw.config.signals import DESCRIBED

MOST_JOINTS = 21  # position, torque and speed of each have a bit in a mask of 64
Device = JointConfig | ImuConfig | StarTrackerConfig | Actuator


def feeds_go_with(buses: Sequence[BusConfig], devices: Mapping[str, Device]) -> None:
    """Raise ValueError for a device whose bus is not a feed, or a feed without a device.

    Parameters
    ----------
    devices : sections of all devices that have a key `bus`, by the place of each
    """
    sampled = sorted(bus.name for bus in buses if bus.interface == SAMPLES)
    feeds = [bus.name for bus in buses if bus.feed is not None]
    for at, device in devices.items():
        driver = None if isinstance(device, Actuator) else device.driver
        if driver == SAMPLES and device.bus is not None and device.bus not in sampled:
            raise ValueError(f"{at}.bus: {device.bus!r} with driver: samples; must be of {sampled}")
        if driver is None and device.bus in feeds:
            raise ValueError(f"{at}.bus: {device.bus!r} is a feed, which carries none")
        if driver != SAMPLES and device.bus in feeds:
            raise ValueError(f"{at}.driver: {driver!r} on feed {device.bus!r}; must be samples")
        is_sensor = isinstance(device, ImuConfig | StarTrackerConfig)
        if is_sensor and device.bus and driver not in (SAMPLES, DESCRIBED):
            raise ValueError(f"{at}.bus: {device.bus!r} with driver {driver}; must be left out")
    for i, bus in enumerate(buses):
        own = [device for device in devices.values() if device.bus == bus.name]
        joints = sum(isinstance(device, JointConfig) for device in own)
        if bus.feed is not None and not own:
            raise ValueError(f"buses.{i}.feed: no joint, imu or star_tracker uses {bus.name!r}")
        if bus.feed is not None and joints > MOST_JOINTS:
            raise ValueError(f"buses.{i}.feed: {joints} joints; must be at most {MOST_JOINTS}")
