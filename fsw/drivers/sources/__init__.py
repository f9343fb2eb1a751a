"""Sources: each turns frames or bytes of a bus or device into samples; no clock, no thread."""

from fsw.drivers.sources.bus_selection import BusSelector
from fsw.drivers.sources.described import DescribedBusSource
from fsw.drivers.sources.feed import FeedSource
from fsw.drivers.sources.imu import ImuSource
from fsw.drivers.sources.joints import JointBusSource
from fsw.drivers.sources.star_tracker import StarTrackerSource

__all__ = [
    "BusSelector",
    "DescribedBusSource",
    "FeedSource",
    "ImuSource",
    "JointBusSource",
    "StarTrackerSource",
]
