"""Health of one CAN bus as its controller's error frames report it."""

from collections import deque

from fsw.drivers.codecs.can_error import BusCondition, decode_error
from fsw.drivers.wire import CanFrame, Reject
from fsw.messages.findings import Fault

MAX_EVENTS = 256
ERROR_BUS_OFF, ERROR_RESTARTED = 0x040, 0x100  # classes of a SocketCAN error frame
QUIET_NS = 1_000_000_000  # a repeated condition is reported once in this time
STATES = {
    BusCondition.BUS_OFF: ("high", "the controller is off the bus"),
    BusCondition.ERROR_PASSIVE: ("medium", "the controller is error passive"),
    BusCondition.ERROR_WARNING: ("low", "the controller's error counters are above the warning"),
    BusCondition.RESTARTED: ("info", "the controller is on the bus again"),
    BusCondition.ERROR_ACTIVE: ("info", "the controller is error active again"),
}


class BusErrors:
    """Counts every condition and makes an event for each change of the controller's state.

    The other conditions (arbitration lost, no acknowledge ...) may come by the hundred: each of
    them makes an event at most once a second.
    """

    def __init__(self) -> None:
        self.frames = 0
        self.counts = dict.fromkeys(BusCondition, 0)
        self._state: BusCondition | None = None
        self._reported_ns: dict[BusCondition, int] = {}

    def feed(self, frame: CanFrame) -> list[tuple[str, str, str]]:
        """Accept an error frame; return severity, code and text of every event that it makes."""
        self.frames += 1
        report = decode_error(frame.can_id, frame.data)
        if isinstance(report, Reject):
            return []
        events = []
        for condition in report.conditions:
            self.counts[condition] += 1
            event = self._event(condition, frame.t_ns)
            if event is not None:
                severity, text = event
                if report.transmit_errors is not None:
                    text += f" (errors: {report.transmit_errors} sending,"
                    text += f" {report.receive_errors} receiving)"
                events.append((severity, f"CAN_{condition.upper()}", text))
        return events

    def _event(self, condition: BusCondition, t_ns: int) -> tuple[str, str] | None:
        if condition in STATES:
            if condition is self._state:
                return None
            self._state = condition
            return STATES[condition]
        reported_ns = self._reported_ns.get(condition)
        if reported_ns is not None and t_ns - reported_ns < QUIET_NS:
            return None
        self._reported_ns[condition] = t_ns
        return "low", f"{condition.replace('_', ' ')}, {self.counts[condition]} in all"


class BusReports:
    """What a source reports about its bus besides samples: events and counters."""

    def __init__(self, bus: str) -> None:
        self._bus, self._errors = bus, BusErrors()
        self._events: deque[tuple[str, str, str]] = deque(maxlen=MAX_EVENTS)
        self.other_frames = 0
        self.torque_unusable = 0

    def event(self, severity: str, code: str, text: str) -> None:
        """Add an event."""
        self._events.append((severity, code, f"{self._bus}: {text}"))

    def events(self) -> list[tuple[str, str, str]]:
        """Return the events since the last call: severity, code and text of each."""
        out = list(self._events)
        self._events.clear()
        return out

    def error(self, frame: CanFrame) -> tuple[Fault, str] | None:
        """Accept an error frame of the bus controller; return the fault that it shows, if any."""
        for event in self._errors.feed(frame):
            self.event(*event)
        if frame.can_id & ERROR_BUS_OFF:
            return Fault.BUS_OFF, "the controller went bus-off"
        if frame.can_id & ERROR_RESTARTED:
            return None
        return Fault.BUS_ERRORS, f"class 0x{frame.can_id:03x}"

    def counters(self) -> dict[str, int]:
        """Return the counters of the bus itself."""
        return {
            "other_frames": self.other_frames,
            "error_frames": self._errors.frames,
            **{f"can_{name}": count for name, count in self._errors.counts.items()},
            "torque_unusable": self.torque_unusable,
        }
