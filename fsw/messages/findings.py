"""Findings: one code per fault, found by a rule on stamps and values.

The part that sees a fault first (source, conditioning, estimator, monitor) makes a `Finding`;
`fsw.health` turns findings into incidents with hysteresis, events and counters.
"""

from dataclasses import dataclass
from enum import StrEnum


class Fault(StrEnum):
    """Faults that the daemon distinguishes; the value names both the event and the counter.

    A new fault is the last: the order gives the numbers of the events on the ground.
    """

    # a CAN bus
    SYNC_LOST = "SYNC_LOST"
    SYNC_DOUBLED = "SYNC_DOUBLED"
    BUS_OFF = "BUS_OFF"
    BUS_ERRORS = "BUS_ERRORS"
    BUS_SILENT = "BUS_SILENT"
    BUS_BABBLE = "BUS_BABBLE"
    NODE_UNKNOWN = "NODE_UNKNOWN"
    # a joint node
    NODE_RESTARTED = "NODE_RESTARTED"
    NODE_NO_SYNC = "NODE_NO_SYNC"
    NODE_TEST_DATA = "NODE_TEST_DATA"
    JOINT_SILENT = "JOINT_SILENT"
    JOINT_LOST = "JOINT_LOST"
    JOINT_DUPLICATE = "JOINT_DUPLICATE"
    JOINT_ORDER = "JOINT_ORDER"
    JOINT_LATE = "JOINT_LATE"
    JOINT_LENGTH = "JOINT_LENGTH"
    JOINT_COUNTER = "JOINT_COUNTER"
    # sensors of a joint node
    ENCODER_FAULT = "ENCODER_FAULT"
    ENCODER_JUMP = "ENCODER_JUMP"
    ENCODER_STUCK = "ENCODER_STUCK"
    ENCODER_SPIKE = "ENCODER_SPIKE"
    TORQUE_FAULT = "TORQUE_FAULT"
    TORQUE_OVERLOAD = "TORQUE_OVERLOAD"
    TORQUE_RANGE = "TORQUE_RANGE"
    TORQUE_STUCK = "TORQUE_STUCK"
    TORQUE_SPIKE = "TORQUE_SPIKE"
    TORQUE_INCONSISTENT = "TORQUE_INCONSISTENT"
    # the inertial unit
    IMU_SILENT = "IMU_SILENT"
    IMU_LOST = "IMU_LOST"
    IMU_BYTES_LOST = "IMU_BYTES_LOST"
    IMU_CRC = "IMU_CRC"
    IMU_NOISE = "IMU_NOISE"
    IMU_DUPLICATE = "IMU_DUPLICATE"
    IMU_COUNTER = "IMU_COUNTER"
    IMU_LATENCY = "IMU_LATENCY"
    IMU_JITTER = "IMU_JITTER"
    IMU_RANGE = "IMU_RANGE"
    IMU_START_UP = "IMU_START_UP"
    GYRO_FAULT = "GYRO_FAULT"
    GYRO_OVERLOAD = "GYRO_OVERLOAD"
    GYRO_STUCK = "GYRO_STUCK"
    GYRO_SPIKE = "GYRO_SPIKE"
    GYRO_INCONSISTENT = "GYRO_INCONSISTENT"
    ACC_FAULT = "ACC_FAULT"
    ACC_OVERLOAD = "ACC_OVERLOAD"
    ACC_STUCK = "ACC_STUCK"
    ACC_SPIKE = "ACC_SPIKE"
    ACC_INCONSISTENT = "ACC_INCONSISTENT"
    # the star tracker
    TRACKER_SILENT = "TRACKER_SILENT"
    TRACKER_LOST = "TRACKER_LOST"
    TRACKER_DAMAGED = "TRACKER_DAMAGED"
    TRACKER_NOISE = "TRACKER_NOISE"
    TRACKER_DUPLICATE = "TRACKER_DUPLICATE"
    TRACKER_CLOCK = "TRACKER_CLOCK"
    TRACKER_LATE = "TRACKER_LATE"
    TRACKER_BLIND = "TRACKER_BLIND"
    TRACKER_RANGE = "TRACKER_RANGE"
    TRACKER_FLIP = "TRACKER_FLIP"
    TRACKER_JUMP = "TRACKER_JUMP"
    # the machine
    LOOP_OVERRUN = "LOOP_OVERRUN"
    LOOP_STALLED = "LOOP_STALLED"
    LOOP_OVER_BUDGET = "LOOP_OVER_BUDGET"
    # actuators of the base
    WHEEL_SILENT = "WHEEL_SILENT"
    WHEEL_INCONSISTENT = "WHEEL_INCONSISTENT"
    THRUSTER_SILENT = "THRUSTER_SILENT"
    THRUSTER_UNKNOWN = "THRUSTER_UNKNOWN"
    # a CAN bus
    NODE_CONTESTED = "NODE_CONTESTED"
    SYNC_CREEPS = "SYNC_CREEPS"


HIGH = frozenset(
    {
        Fault.BUS_OFF,
        Fault.BUS_SILENT,
        Fault.JOINT_SILENT,
        Fault.WHEEL_SILENT,
        Fault.THRUSTER_SILENT,
        Fault.IMU_SILENT,
    }
)
LOW = frozenset(
    {
        Fault.SYNC_LOST,
        Fault.BUS_ERRORS,
        Fault.JOINT_LOST,
        Fault.JOINT_DUPLICATE,
        Fault.JOINT_ORDER,
        Fault.ENCODER_SPIKE,
        Fault.TORQUE_SPIKE,
        Fault.IMU_LOST,
        Fault.IMU_NOISE,
        Fault.IMU_DUPLICATE,
        Fault.GYRO_SPIKE,
        Fault.ACC_SPIKE,
        Fault.TRACKER_LOST,
        Fault.TRACKER_NOISE,
        Fault.TRACKER_DUPLICATE,
        Fault.LOOP_STALLED,
        Fault.LOOP_OVER_BUDGET,
    }
)


def severity(fault: Fault) -> str:
    """Return how much an operator should care: high, medium or low."""
    return "high" if fault in HIGH else "low" if fault in LOW else "medium"


@dataclass(frozen=True, slots=True)
class Finding:
    """One observation of a fault."""

    t_ns: int  # time of the data that showed the fault, on the daemon's clock
    fault: Fault
    subject: str  # bus, joint or device
    text: str = ""


@dataclass(frozen=True, slots=True)
class Stall:
    """A span of time in which the loop was due to run but had no processor."""

    start_ns: int
    end_ns: int
    slips: int  # grid points missed in this span
