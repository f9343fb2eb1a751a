"""Section of health: limits for faults of sensors and of the loop."""

from pydantic import Field

from fsw.config.base import Positive, Section
from fsw.messages.false_alarms import per_test


class HealthConfig(Section):
    """Fault detection; periods are sample periods of the sensor concerned."""

    silent_periods: float = Field(default=3.0, ge=2.0, le=10_000.0)
    """a sensor that misses so many samples in a row is silent"""
    late_periods: int = Field(default=2, ge=2, le=100)
    """a joint sample that comes so many SYNCs behind its own is late; one is usual"""
    stuck: bool = True
    """readings that noise would never make equal so often in a row are a fault; false for a
    simulation without noise"""
    recover_s: Positive = 0.5
    """a fault that has not been seen for so long is over"""
    jitter_s: Positive = 0.003
    """arrivals of the inertial unit that are later by more than its clock allows are scattered"""
    tracker_late_s: Positive = 0.05
    """a solution later by more than the unit's clock allows is not used"""
    false_alarm_probability: float = Field(default=per_test("sensor"), gt=0, le=1e-3)
    """of calling one channel of one window inconsistent with the model"""
    stall_s: Positive = 0.005
    """a loop that gets no processor for so long has been stalled"""
    slip_ratio: float = Field(default=0.2, gt=0, le=1)
    """share of ticks missed in half a second that makes an overrun"""
