"""Error frames of a CAN controller: conditions of the bus and of the controller.

Source: Linux include/uapi/linux/can/error.h. An error frame's identifier holds error classes as
bits; its eight data bytes hold the details.
"""

from dataclasses import dataclass
from enum import StrEnum

from fsw.drivers.wire import Reject

_LENGTH = 8
_CONTROLLER_CLASS, _CONTROLLER_BYTE = 0x004, 1
_COUNTERS_CLASS, _TRANSMIT_ERRORS_BYTE, _RECEIVE_ERRORS_BYTE = 0x200, 6, 7


class BusCondition(StrEnum):
    """Conditions that an error frame reports; each has its own counter."""

    TX_TIMEOUT = "tx_timeout"
    ARBITRATION_LOST = "arbitration_lost"
    CONTROLLER_OVERFLOW = "controller_overflow"  # frames lost inside the controller
    ERROR_WARNING = "error_warning"
    ERROR_PASSIVE = "error_passive"
    ERROR_ACTIVE = "error_active"  # normal again
    PROTOCOL = "protocol"
    TRANSCEIVER = "transceiver"
    NO_ACKNOWLEDGE = "no_acknowledge"
    BUS_OFF = "bus_off"
    BUS_ERROR = "bus_error"
    RESTARTED = "restarted"  # after bus-off


_CLASSES = {
    0x001: BusCondition.TX_TIMEOUT,
    0x002: BusCondition.ARBITRATION_LOST,
    0x008: BusCondition.PROTOCOL,
    0x010: BusCondition.TRANSCEIVER,
    0x020: BusCondition.NO_ACKNOWLEDGE,
    0x040: BusCondition.BUS_OFF,
    0x080: BusCondition.BUS_ERROR,
    0x100: BusCondition.RESTARTED,
}
_CONTROLLER = {
    0x03: BusCondition.CONTROLLER_OVERFLOW,
    0x0C: BusCondition.ERROR_WARNING,
    0x30: BusCondition.ERROR_PASSIVE,
    0x40: BusCondition.ERROR_ACTIVE,
}


@dataclass(frozen=True, slots=True)
class BusErrorReport:
    """Conditions in one error frame; error counters are None if the controller gives none."""

    conditions: tuple[BusCondition, ...]
    transmit_errors: int | None
    receive_errors: int | None


def decode_error(classes: int, data: bytes) -> BusErrorReport | Reject:
    """Decode an error frame from the class bits of its identifier and its data."""
    if len(data) != _LENGTH:
        return Reject.LENGTH
    found = [condition for bit, condition in _CLASSES.items() if classes & bit]
    if classes & _CONTROLLER_CLASS:
        details = data[_CONTROLLER_BYTE]
        found += [condition for bits, condition in _CONTROLLER.items() if details & bits]
    counted = bool(classes & _COUNTERS_CLASS)
    return BusErrorReport(
        tuple(found),
        data[_TRANSMIT_ERRORS_BYTE] if counted else None,
        data[_RECEIVE_ERRORS_BYTE] if counted else None,
    )
