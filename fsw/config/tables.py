"""Tables that can be uplinked: what they may hold. The same strictness as the configuration's."""

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
    """Noise of one joint; what is left out stays."""

    torque_noise_nm: TorqueNoise | None = None
    torque_offset_sigma_nm: TorqueSigma | None = None
    torque_scale_sigma_ratio: ScaleSigma | None = None
    position_noise_rad: AngleNoise | None = None


class ImuNoise(Section):
    """Noise of the inertial unit."""

    angle_random_walk_rad_sqrt_s: RandomWalk | None = None
    velocity_random_walk_m_s_sqrt_s: RandomWalk | None = None
    gyro_bias_sigma_rad_s: RateSigma | None = None
    acc_bias_sigma_m_s2: AccelerationSigma | None = None


class TrackerNoise(Section):
    """Noise of the star tracker."""

    noise_across_rad: AngleNoise | None = None
    noise_about_rad: AngleNoise | None = None


class ModelNoise(Section):
    """Effects that the model leaves out."""

    wrench_force_sigma_n: ForceNoise | None = None
    wrench_torque_sigma_nm: TorqueNoise | None = None
    momentum_sigma_nms: MomentumSigma | None = None
    external_force_sigma_n: ForceSigma | None = None
    external_torque_sigma_nm: TorqueSigma | None = None
    target_force_sigma_n: ForceSigma | None = None
    target_torque_sigma_nm: TorqueSigma | None = None


class NoiseTable(Section):
    """Noise and priors, above the configuration's."""

    joints: dict[str, JointNoise] = Field(default_factory=dict)
    imu: ImuNoise = ImuNoise()
    star_tracker: TrackerNoise = TrackerNoise()
    estimator: ModelNoise = ModelNoise()
    bodies: dict[BodyName, BodyConfig] = Field(default_factory=dict)


class SetRate(Section):
    """How one housekeeping set is reported."""

    interval_s: float = Field(ge=0.01, le=3600.0, allow_inf_nan=False)
    enabled: bool = True


class RatesTable(Section):
    """Rates of the housekeeping sets; sets left out stay as they are."""

    sets: dict[int, SetRate]

    @model_validator(mode="after")
    def _known(self) -> Self:
        unknown = sorted(set(self.sets) - {*range(1, 9), 20})
        if unknown:
            raise ValueError(f"sets: {unknown}: there are 1 to 8, and 20")
        return self


class MonitorConfig(Section):
    """One limit: a telemetered value, its bounds, and what happens, once, when it leaves them."""

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
