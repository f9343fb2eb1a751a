"""The wire formats of simulated inertial units: each is a module with a class `Wire`.

Each module is written from the unit's document. It shares no code with the flight software.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from hil.world.sensor_config import ImuSensorConfig

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Batch:
    """k consecutive samples; values in S axes, averaged over the period where the wire says so."""

    number: IntArray  # (k,) of the sample since power-on
    counter0: int  # 0 to 255, drawn once for each seed
    period_s: float  # nominal time between samples, on the unit's own clock
    w_NS_S_rad_s: FloatArray  # (k, 3)
    f_NS_S_m_s2: FloatArray  # (k, 3)
    latency_us: IntArray  # (k,) from the sample to the first bit
    starting: NDArray[np.bool_]  # (k,) whether the unit still starts


class Wire(Protocol):
    """One wire format."""

    driver: ClassVar[str]  # of the flight software, which reads it
    has_latency: bool  # whether a datagram says how long it waited
    averages: tuple[bool, bool]  # whether gyro and accelerometer give means over a period
    length: int  # of the longest datagram [bytes]
    options: Mapping[str, Any]  # of the driver

    def __init__(self, config: ImuSensorConfig) -> None: ...

    def encode(self, batch: Batch) -> list[bytes]:
        """Return one datagram for each sample."""
        ...


def wire_of(config: ImuSensorConfig) -> Wire:
    """Return the wire format of a unit; `config.device` is a module, by default of hil.devices."""
    name = config.device if "." in config.device else f"hil.devices.{config.device}"
    try:
        module = import_module(name)
    except ModuleNotFoundError as error:
        raise ValueError(f"sensors.imu.device: no module, {error} (value: {name})") from error
    wire: Wire = module.Wire(config)
    return wire
