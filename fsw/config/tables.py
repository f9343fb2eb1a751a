"""Schemas of the tables that the ground can uplink, as strict as the configuration's."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from fsw.config.base import (
    AccelerationSigma,
    AngleNoise,
    BodyName,
    Finite,
    ForceNoise,
    ForceSigma,
    MomentumSigma,
    NonNegative,
    RandomWalk,
    RateSigma,
    ScaleSigma,
    Section,
    TorqueNoise,
    TorqueSigma,
)
from fsw.config.robot import BodyConfig

MAX_MONITORS = 64


class JointNoise(Section):
    """Noise and priors of one joint; None: the value of the configuration stays."""

    torque_noise_nm: TorqueNoise | None = None
    torque_offset_sigma_nm: TorqueSigma | None = None
    torque_scale_sigma_ratio: ScaleSigma | None = None
    position_noise_rad: AngleNoise | None = None


class ImuNoise(Section):
    """Noise and priors of the inertial unit; None: the value of the configuration stays."""

    angle_random_walk_rad_sqrt_s: RandomWalk | None = None
    velocity_random_walk_m_s_sqrt_s: RandomWalk | None = None
    gyro_bias_sigma_rad_s: RateSigma | None = None
    acc_bias_sigma_m_s2: AccelerationSigma | None = None


class TrackerNoise(Section):
    """Noise of the star tracker; None: the value of the configuration stays."""

    noise_across_rad: AngleNoise | None = None
    noise_about_rad: AngleNoise | None = None


class ModelNoise(Section):
    """Sigmas of external wrenches and momentum; None: the value of the configuration stays."""

    wrench_force_sigma_n: ForceNoise | None = None
    wrench_torque_sigma_nm: TorqueNoise | None = None
    momentum_sigma_nms: MomentumSigma | None = None
    external_force_sigma_n: ForceSigma | None = None
    external_torque_sigma_nm: TorqueSigma | None = None
    target_force_sigma_n: ForceSigma | None = None
    target_torque_sigma_nm: TorqueSigma | None = None


class NoiseTable(Section):
    """Noise and priors that replace those of the configuration."""

    joints: dict[str, JointNoise] = Field(default_factory=dict)
    imu: ImuNoise = ImuNoise()
    star_tracker: TrackerNoise = TrackerNoise()
    estimator: ModelNoise = ModelNoise()
    bodies: dict[BodyName, BodyConfig] = Field(default_factory=dict)


class SetRate(Section):
    """Interval of one housekeeping set, and whether it is reported."""

    interval_s: float = Field(ge=0.01, le=3600.0, allow_inf_nan=False)
    enabled: bool = True


class RatesTable(Section):
    """Rates of housekeeping sets by number; sets that are not listed stay as they are."""

    sets: dict[int, SetRate]

    @model_validator(mode="after")
    def _known(self) -> Self:
        unknown = sorted(set(self.sets) - {*range(1, 9), 20})
        if unknown:
            raise ValueError(f"sets: {unknown}: there are 1 to 8, and 20")
        return self


class MonitorConfig(Section):
    """One limit monitor: a value of telemetry, its bounds, and the action when it leaves them."""

    id: int = Field(ge=1, le=65535)
    value: Annotated[str, Field(pattern=r"^[a-z]+\.[a-z0-9_]+$")]  # set.field
    low: Finite | None = None
    high: Finite | None = None
    repetitions: int = Field(default=3, ge=1, le=1000)
    stale_s: NonNegative = 0.0  # a value older than this is reported as stale; 0: never
    enabled: bool = True
    action: Literal["none", "safe", "standby", "reset_estimator", "abort_batch"] = "none"

    @model_validator(mode="after")
    def _bounds(self) -> Self:
        if self.low is None and self.high is None and self.stale_s == 0:
            raise ValueError(f"monitor {self.id}: needs low, high or stale_s")
        if self.low is not None and self.high is not None and self.low > self.high:
            raise ValueError(f"monitor {self.id}: low {self.low} is above high {self.high}")
        return self


class MonitorsTable(Section):
    """All limit monitors."""

    monitors: Annotated[tuple[MonitorConfig, ...], Field(max_length=MAX_MONITORS)]

    @model_validator(mode="after")
    def _unique(self) -> Self:
        numbers = [monitor.id for monitor in self.monitors]
        twice = sorted({n for n in numbers if numbers.count(n) > 1})
        if twice:
            raise ValueError(f"monitors.id: {twice} used more than once")
        return self
