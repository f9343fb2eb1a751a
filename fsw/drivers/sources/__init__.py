"""Sources: each turns frames or bytes of a bus or device into samples; no clock, no thread."""

from fsw.drivers.sources.bus_selection import BusSelector
from fsw.drivers.sources.described import DescribedBusSource
from fsw.drivers.sources.described_wheels import DescribedWheelSource
from fsw.drivers.sources.feed import FeedSource
from fsw.drivers.sources.imu import ImuSource
from fsw.drivers.sources.joints import JointBusSource
from fsw.drivers.sources.star_tracker import StarTrackerSource
from fsw.drivers.sources.thrusters import ThrusterBusSource
from fsw.drivers.sources.wheels import WheelBusSource

__all__ = [
    "BusSelector",
    "DescribedBusSource",
    "DescribedWheelSource",
    "FeedSource",
    "ImuSource",
    "JointBusSource",
    "StarTrackerSource",
    "ThrusterBusSource",
    "WheelBusSource",
]
