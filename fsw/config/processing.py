"""Sections of data processing: loop, estimator, orbit."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from fsw.config.base import (
    Delay,
    Duration,
    ForceNoise,
    ForceSigma,
    LongDuration,
    MomentumSigma,
    Positive,
    Rate,
    Section,
    TorqueNoise,
    TorqueSigma,
    Vector3,
)
from fsw.config.constants import EARTH_GRAVITY_PARAMETER_M3_S2
from fsw.config.feed import SAMPLES
from fsw.messages.false_alarms import per_test

WindowLength = Annotated[float, Field(gt=0, le=1e3, allow_inf_nan=False)]  # s


class SchedulerConfig(Section):
    """Timing of the loop; processors and priorities of loop and estimation."""

    tick_rate_hz: Rate
    batch_s: float = Field(default=0.033, gt=0.0, le=0.05)  # length of a batch of inputs
    work_budget_s: Duration | None = None  # processor time for a tick; null: the tick's period
    realtime_priority: int = Field(default=50, ge=0, le=99)  # 0: no SCHED_FIFO
    cpu: int | None = Field(default=None, ge=0)
    idle_latency_us: int | None = Field(default=None, ge=0, le=1_000_000)  # null: unchanged
    estimation_priority: int | None = Field(default=None, ge=0, le=98)  # null: half the loop's
    estimation_cpu: int | None = Field(default=None, ge=0)

    @property
    def estimation_fifo(self) -> int:
        """SCHED_FIFO priority of the estimation; 0: ordinary scheduling."""
        given = self.estimation_priority
        return self.realtime_priority // 2 if given is None else given

    @model_validator(mode="after")
    def _below_the_loop(self) -> Self:
        priority = self.estimation_priority
        if priority and priority >= self.realtime_priority:
            raise ValueError(
                f"estimation_priority: {priority} must be below realtime_priority "
                f"{self.realtime_priority}: the loop comes first"
            )
        return self


# least windows of a recorded arm that is held: a fit uses up about one of them, and with four left,
# what they show of the noise makes sigma 2.2 times as wide; with three, 3 times
LEAST_WINDOWS = 5


def for_short_recordings(data: object) -> object:
    """Return the data of a configuration with `estimator.settle_blocks` where it is left out.

    A held arm whose samples exist only in recordings never flies, and sigma counts its few windows.
    """
    if not isinstance(data, dict):
        return data
    estimator, base, buses = (data.get(key) or {} for key in ("estimator", "base", "buses"))
    sections = (
        isinstance(estimator, dict) and isinstance(base, dict) and isinstance(buses, list | tuple)
    )
    if not sections or estimator.get("settle_blocks") is not None:
        return data
    is_held = base.get("motion", "free") != "free" and estimator.get("weighting", "eiv") == "eiv"
    recorded = [isinstance(bus, dict) and _is_recorded(bus) for bus in buses]
    if not (is_held and recorded and all(recorded)):
        return data
    return data | {"estimator": estimator | {"settle_blocks": LEAST_WINDOWS}}


def _is_recorded(bus: dict[str, object]) -> bool:
    """Return whether the values of a bus exist only in recordings."""
    return bus.get("interface") == SAMPLES and bus.get("feed") is None


class EstimatorConfig(Section):
    """Method, windows, priors and gates of the estimator."""

    method: Literal["mrnea", "rda", "cm", "fused"] = "fused"
    weighting: Literal["ols", "wls", "eiv"] = "eiv"  # for mrnea
    window_s: WindowLength = 0.4
    nodes: int = Field(default=4, ge=2, le=8)
    lag_s: Delay = 0.15  # a window closes this long after its end; covers the slowest sensor
    store_blocks: int = Field(default=256, ge=4, le=100_000)
    # windows before an estimate may be valid; see `for_short_recordings`
    settle_blocks: int = Field(default=25, ge=1)
    min_fill_ratio: float = Field(default=0.6, gt=0, le=1)  # of the expected samples in a window
    wrench_force_sigma_n: ForceNoise = 1e-3  # 1 sigma of unmodelled external force and torque
    wrench_torque_sigma_nm: TorqueNoise = 1e-3
    momentum_sigma_nms: MomentumSigma = (
        0.0  # prior of a residual angular momentum; 0: none estimated
    )
    external_force_sigma_n: ForceSigma = 0.0  # prior of a constant external wrench at the base's
    external_torque_sigma_nm: TorqueSigma = 0.0  # origin, axes of N; 0: none estimated
    target_force_sigma_n: ForceSigma = 0.0  # prior of a constant wrench at the target's centre of
    target_torque_sigma_nm: TorqueSigma = 0.0  # mass, such as air; 0: none estimated
    outside_wrench: Literal["ignore", "watch"] = "ignore"  # watch: find and leave out windows
    # false-alarm rate of the innovation gate, per window
    gate_probability: float = Field(default=per_test("gate"), gt=0, lt=0.1)
    condition_limit: Positive = 1e8
    forgetting_time_s: LongDuration | None = None  # time constant of information; null: none

    @property
    def is_regression(self) -> bool:
        """Whether the method is a regression of the paper, for which arm and sensors are exact."""
        return self.method == "mrnea" and self.weighting != "eiv"


class OrbitConfig(Section):
    """A circular orbit, which adds the gravity gradient to the model. Needs a star tracker.

    The state is that of the system's centre of mass at the epoch, from the Earth's centre, in N.
    """

    position_m: Vector3
    velocity_m_s: Vector3
    epoch_ns: int | None = None  # time of the daemon's clock; null: first SYNC
    gravity_parameter_m3_s2: Positive = EARTH_GRAVITY_PARAMETER_M3_S2

    @model_validator(mode="after")
    def _circular(self) -> Self:
        radius = sum(x * x for x in self.position_m) ** 0.5
        speed = sum(v * v for v in self.velocity_m_s) ** 0.5
        circular = (self.gravity_parameter_m3_s2 / radius) ** 0.5 if radius > 0 else 0.0
        along = sum(x * v for x, v in zip(self.position_m, self.velocity_m_s, strict=True))
        if not (abs(speed - circular) <= 0.02 * circular and abs(along) <= 0.02 * radius * speed):
            raise ValueError(
                f"velocity_m_s {list(self.velocity_m_s)} must be across position_m and within 2 % "
                f"of the circular {circular:.1f} m/s"
            )
        return self
