"""Section of health: limits for faults of sensors and of the loop."""

from pydantic import Field

from fsw.config.base import Positive, Section
from fsw.messages.false_alarms import per_test


class HealthConfig(Section):
    """Fault detection; periods are sample periods of the sensor concerned."""

    silent_periods: float = Field(default=3.0, ge=2.0, le=10_000.0)
    late_periods: int = Field(default=2, ge=2, le=100)  # a joint sample this many SYNCs old is late
    stuck: bool = True  # equal readings in a row are a fault; false: for noise-free simulations
    recover_s: Positive = 0.5  # a fault that does not recur for this time is over
    jitter_s: Positive = 0.003  # largest lateness of the inertial unit's arrivals by its clock
    tracker_late_s: Positive = 0.05  # largest lateness of a solution by the unit's clock
    false_alarm_probability: float = Field(  # of one test of one sensor's innovation
        default=per_test("sensor"), gt=0, le=1e-3
    )
    stall_s: Positive = 0.005  # the loop is stalled if it gets no processor for this time
    slip_ratio: float = Field(default=0.2, gt=0, le=1)  # share of ticks missed in half a second
