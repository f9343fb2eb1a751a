"""When the daemon calls a sensor faulty, and when healthy again."""

from pydantic import Field

from fsw.config.base import Positive, Section


class HealthConfig(Section):
    """Fault detection. Periods are those of the sensor in question."""

    silent_periods: float = Field(default=3.0, ge=2.0, le=10_000.0)
    late_periods: int = Field(default=2, ge=2, le=100)  # SYNCs a joint sample may come behind its
    stuck: bool = True  # equal readings in a row are a fault; false: of a noise-free simulation
    recover_s: Positive = 0.5  # a fault not seen for so long is over
    jitter_s: Positive = 0.003  # arrivals of the inertial unit scattered by more
    tracker_late_s: Positive = 0.05  # solutions later than the unit's clock allows by more
    false_alarm_probability: float = Field(default=1e-9, gt=0, le=1e-3)  # of one plausibility test
    stall_s: Positive = 0.005  # a loop that gets no processor for so long has been stalled
    slip_ratio: float = Field(default=0.2, gt=0, le=1)  # ticks missed over half a second
