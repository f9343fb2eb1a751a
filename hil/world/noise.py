"""Noise of sensor channels: Simulink's band-limited white noise, and torque hysteresis.

Source of the paper's profile: Rackl, Lampariello, Albu-Schaeffer (2013), sec. 3.2: band-limited
white noise of power 0.1 at 0.1 ms with seed 23000 and gain 0.01 on joint angle, torque, attitude,
base acceleration and base rate. The paper does not define these numbers, so readings are options.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import ConfigDict, Field

from hil.devices.truth_port import FloatArray

STRICT = ConfigDict(extra="forbid")
Reading = Literal["variance", "literal"]
Decimation = Literal["pick", "average"]
BLOCK_STREAM = 401  # spawn key of the noise blocks, different from all devices' keys


@dataclass(frozen=True, slots=True, kw_only=True)
class BandLimitedWhiteNoise:
    """Simulink's block Band-Limited White Noise times a gain, sampled at a device's rate.

    The block draws a Gaussian value every `sample_time_s`. The variance is power / sample_time_s
    with `reading` "literal", and power with "variance". A sample is one value of the block with
    `decimation` "pick", and the mean over the device's period with "average".
    """

    __pydantic_config__ = STRICT
    power: Annotated[float, Field(ge=0)] = 0.1
    sample_time_s: Annotated[float, Field(gt=0)] = 1e-4
    seed: int = 23000
    gain: float = 0.01
    reading: Reading = "variance"
    decimation: Decimation = "pick"
    shared: bool = False  # one seed gives every channel and axis the same sequence

    @property
    def block_sigma(self) -> float:
        """Return 1 sigma of one value of the block times the gain."""
        variance = self.power / self.sample_time_s if self.reading == "literal" else self.power
        return abs(self.gain) * math.sqrt(variance)

    def sigma(self, rate_hz: float) -> float:
        """Return 1 sigma of one sample at a device's rate [Hz]."""
        held = self.held(rate_hz) if self.decimation == "average" else 1
        return self.block_sigma / math.sqrt(held)

    def held(self, rate_hz: float) -> int:
        """Return the number of block values in one sample of a device.

        Raises
        ------
        ValueError if that is not a whole number.
        """
        count = 1.0 / (rate_hz * self.sample_time_s)
        if count < 1.0 - 1e-9 or abs(count - round(count)) > 1e-6:
            raise ValueError(
                f"noise: {rate_hz} Hz does not divide the block's {1 / self.sample_time_s:g} Hz"
            )
        return round(count)


class NoiseStream:
    """The samples of one channel with several axes, in order.

    Parameters
    ----------
    noise : the profile
    rate_hz : sample rate of the device [Hz]
    axes : number of columns of the samples
    run_seed, channel : the run's seed and the channel's number; a shared sequence uses neither,
        only the seed of the block
    """

    def __init__(
        self,
        noise: BandLimitedWhiteNoise,
        rate_hz: float,
        axes: int,
        run_seed: int = 0,
        channel: int = 0,
    ) -> None:
        self._noise, self._held = noise, noise.held(rate_hz)
        key = () if noise.shared else (BLOCK_STREAM, run_seed, channel)
        self._rng = np.random.default_rng(np.random.SeedSequence(noise.seed, spawn_key=key))
        self._axes = axes

    def take(self, count: int) -> FloatArray:
        """Return the next samples (count, axes)."""
        columns = 1 if self._noise.shared else self._axes
        values = self._rng.standard_normal((count, self._held, columns))
        picked = values[:, 0] if self._noise.decimation == "pick" else values.mean(axis=1)
        scaled: FloatArray = self._noise.block_sigma * picked
        return np.broadcast_to(scaled, (count, self._axes)) if self._noise.shared else scaled


class Hysteresis:
    """Rate-independent hysteresis of n torque sensors: a scaled stop operator.

    The error goes from -size to +size while the torque rises by 2 `width`, and back when it falls.
    """

    def __init__(self, size_nm: float, width_nm: float, n: int) -> None:
        self._size, self._width = size_nm, width_nm
        self._stop = np.zeros(n)
        self._last: FloatArray | None = None

    def error_nm(self, tau_nm: FloatArray) -> FloatArray:
        """Return the errors (n,) [N m] at the next torques (n,) [N m]."""
        if self._last is not None:
            self._stop = np.clip(self._stop + tau_nm - self._last, -self._width, self._width)
        self._last = np.array(tau_nm)
        return np.asarray(self._size / self._width * self._stop)
