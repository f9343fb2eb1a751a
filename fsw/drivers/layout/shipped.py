"""Descriptions of the frames of the tailored nodes (docs/icd.md), as any other description.

The DBC files beside the drivers describe the same frames for other tools.
"""

from collections.abc import Mapping
from dataclasses import replace
from math import tau

from fsw.config.joints import TORQUE_STEP_NM
from fsw.config.signals import TimingConfig
from fsw.drivers.layout.decoder import Decoder
from fsw.drivers.layout.joints import COUNTER, STATUS, Layout, Use
from fsw.drivers.layout.signals import Message, Number, Signal

POSITION_SCALE_RAD = tau * 2.0**-24  # also of speeds [rad/s]
TEMPERATURE_SCALE_K = 0.1
STATUS_OF_ACTUATOR = 0xD8  # value valid, fault, SYNC lost, test data
STATUS_ACTUATOR_VALID = 0x08
NODE_ROLES = {"status": STATUS, "counter": COUNTER}


def message_of(name: str, *fields: tuple[str, int, Number, float]) -> Message:
    """Return a message of whole little-endian fields: name, bits, number, scale of each."""
    signals, at = [], 0
    for field, bits, number, scale in fields:
        signals.append(Signal(name=field, start=at, bits=bits, number=number, scale=scale))
        at += bits
    return Message(name=name, identifier=0, length=at // 8, is_exact=True, signals=tuple(signals))


JOINT = message_of(
    "joint",
    ("position", 32, "signed", POSITION_SCALE_RAD),
    ("torque", 16, "signed", TORQUE_STEP_NM["classic"]),
    ("status", 8, "unsigned", 1),
    ("counter", 8, "unsigned", 1),
)
JOINT_FD = message_of(
    "joint_fd",
    ("position", 32, "signed", POSITION_SCALE_RAD),
    ("velocity", 32, "signed", POSITION_SCALE_RAD),
    ("torque", 32, "signed", TORQUE_STEP_NM["fd"]),
    ("status", 16, "unsigned", 1),
    ("counter", 8, "unsigned", 1),
    ("temperature", 8, "signed", 1),
    ("device_time", 32, "unsigned", 1),
)
JOINT_SLOW = message_of(
    "joint_slow",
    ("velocity", 32, "signed", POSITION_SCALE_RAD),
    ("motor_torque", 16, "signed", 1e-3),
    ("temperature", 16, "signed", TEMPERATURE_SCALE_K),
)

READ_JOINT = Decoder(JOINT, JOINT.named("position", "torque", "status", "counter"))
READ_JOINT_FD = Decoder(JOINT_FD, JOINT_FD.named("position", "torque", "status", "counter"))
READ_SPEED_FD = Decoder(JOINT_FD, JOINT_FD.named("velocity", "torque", "status", "counter"))
READ_JOINT_SLOW = Decoder(JOINT_SLOW, JOINT_SLOW.named("velocity", "motor_torque", "temperature"))


def shipped(message: Message, roles: Mapping[str, int], identifier: int) -> Layout:
    """Return how a tailored node's report is read: its message, the roles of its fields, its id."""
    message = replace(message, identifier=identifier)
    pairs = zip(roles.values(), message.named(*roles), strict=True)
    return Layout(
        uses=tuple(Use(role=role, message=message, signal=s, factor=1.0) for role, s in pairs),
        timing=TimingConfig(by="echoed_counter"),
        mask=STATUS_OF_ACTUATOR,
        value=STATUS_ACTUATOR_VALID,
    )
