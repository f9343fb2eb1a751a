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
    """the loop's rate"""
    batch_s: float = Field(default=0.05, gt=0.0, le=0.05)
    """received data are decoded and judged in batches of this length: a fault is found at most this
    long and some ticks after the sample that shows it"""
    work_budget_s: Duration | None = None
    """processor time that the work of one tick may take; what exceeds it is the event
    `LOOP_OVER_BUDGET`; null: the period of a tick"""
    realtime_priority: int = Field(default=50, ge=0, le=99)
    """SCHED_FIFO priority; 0: ordinary scheduling"""
    cpu: int | None = Field(default=None, ge=0)
    """processor the loop is pinned to; null: any"""
    idle_latency_us: int | None = Field(default=None, ge=0, le=1_000_000)
    """processors enter no idle state that takes longer to leave [us]; 0: none sleeps, which costs
    power and makes ticks punctual; needs the right to write `/dev/cpu_dma_latency`; null: as the
    system has it"""
    estimation_priority: int | None = Field(default=None, ge=0, le=98)
    """SCHED_FIFO priority of the estimation, below the loop's; null: half of it; 0: ordinary
    scheduling"""
    estimation_cpu: int | None = Field(default=None, ge=0)
    """processor the estimation is pinned to; null: any"""

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
    """Return the data of a configuration, with a smaller `settle_blocks` for an arm on a bench.

    This applies if the base is held, all samples exist only in recordings, and the key is left out:
    such an arm never flies, and sigma allows for its few windows.
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
    """`mrnea`: inverse dynamics with measured base acceleration; `rda`: base acceleration
    eliminated; `cm`: angular rate by conservation of momentum; `fused`: torque, accelerometer and
    gyro in one likelihood"""
    weighting: Literal["ols", "wls", "eiv"] = "eiv"
    """of `mrnea`. `eiv`: errors in all variables; `wls`: torque and accelerometer noise only;
    `ols`: none (the published method). Other methods have none of these: `fsw check` warns"""
    window_s: WindowLength = 0.4
    """length of the windows in which signals are smoothed; each channel needs at least 8 samples in
    it, the fastest may have 20 000; MRNEA differentiates the gyro over it and wants a short one
    (0.2 s for motions up to 0.4 Hz), fused does not"""
    nodes: int = Field(default=4, ge=2, le=8)
    """instants per window at which equations are set up"""
    lag_s: Delay = 0.15
    """a window closes this long after its end; at least the slowest sensor's delay (`fsw check`
    reports it)"""
    store_blocks: int = Field(default=256, ge=4, le=100_000)
    """windows kept for relinearisation"""
    # windows before an estimate may be valid; see `for_short_recordings`
    settle_blocks: int = Field(default=25, ge=1)
    """windows before anything is published as valid; 5 where it is left out, the base is held and
    every bus has `interface: samples`: sigma then counts how little so few windows show of the
    noise ([methods.md](methods.md))"""
    min_fill_ratio: float = Field(default=0.6, gt=0, le=1)
    """share of the expected samples a window must hold"""
    wrench_force_sigma_n: ForceNoise = 1e-3
    """1 sigma of the unmodelled external force"""
    wrench_torque_sigma_nm: TorqueNoise = 1e-3
    """1 sigma of the unmodelled external torque"""
    momentum_sigma_nms: MomentumSigma = 0.0
    """1 sigma, per axis, of the angular momentum of everything together, N m s; 0: it is zero. For
    what tumbles after a capture, or holds momentum in rotors: as large as it may be, a value too
    large costs nothing ([methods.md](methods.md))"""
    external_force_sigma_n: ForceSigma = 0.0
    """1 sigma of a constant external force on the base, N; 0 together with the torque: none is
    estimated"""
    external_torque_sigma_nm: TorqueSigma = 0.0
    """1 sigma of the constant external moment about the base's origin, N m"""
    target_force_sigma_n: ForceSigma = 0.0
    """1 sigma of a constant external force at the target's centre of mass, N; air on a grasped
    target loads the joints, which no wrench on the base does. One in inertial axes and one in the
    target's; 0 together with the torque: none is estimated"""
    target_torque_sigma_nm: TorqueSigma = 0.0
    """1 sigma of the constant external moment about the target's centre of mass, N m"""
    outside_wrench: Literal["ignore", "watch"] = "ignore"
    """`watch`: firings that nobody reported and contact of the target are found from the first
    valid estimate on, reported (`UNKNOWN_FIRING`, `CONTACT`) and left out
    ([methods.md](methods.md)). Needs `method: fused`, a free base, a star tracker and no `modes`.
    `ignore`: what acts from outside is found as a model that does not fit, or as a change of the
    bodies"""
    gate_probability: float = Field(default=per_test("gate"), gt=0, lt=0.1)
    """false-alarm rate of the innovation gate per window ([budget](false_alarms.md))"""
    condition_limit: Positive = 1e8
    """above this condition number of the scaled information nothing is published as valid"""
    forgetting_time_s: LongDuration | None = None
    """time in which what the data said loses the factor e of its information; null: nothing is
    forgotten"""

    @property
    def is_regression(self) -> bool:
        """Whether the method is a regression of the paper: it assumes exact arm and sensors."""
        return self.method == "mrnea" and self.weighting != "eiv"


class OrbitConfig(Section):
    """A circular orbit, which adds the gravity gradient to the model. Needs a star tracker.

    The state is that of the system's centre of mass at the epoch, from the Earth's centre, in N.
    """

    position_m: Vector3
    """position at the epoch"""
    velocity_m_s: Vector3
    """velocity at the epoch, across the position and within 2 % of circular"""
    epoch_ns: int | None = None
    """the epoch on the daemon's clock; null: the first SYNC"""
    gravity_parameter_m3_s2: Positive = EARTH_GRAVITY_PARAMETER_M3_S2
    """gravity parameter of the central body"""

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
