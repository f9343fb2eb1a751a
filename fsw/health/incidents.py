"""Turns findings into incidents with hysteresis: one event when a fault begins, one when it ends.

An incident is open from its first finding until no finding came for the recovery time. For a fault
that windows show, the recovery time is longer by a window and its lag, so that a fault that
continues is one incident. A finding that an open incident explains (a silent node of a bus that is
off) is a consequence: it is counted, keeps the incident open and makes no event. A stall of the
loop explains findings in the stall and up to 0.1 s after it; later findings are other faults.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

from fsw.messages import Event
from fsw.messages.findings import Fault, Finding, severity

RECOVERED = "RECOVERED"

_NODE = frozenset(
    {
        Fault.JOINT_SILENT,
        Fault.JOINT_LOST,
        Fault.JOINT_LATE,
        Fault.JOINT_ORDER,
        Fault.JOINT_DUPLICATE,
        Fault.JOINT_COUNTER,
        Fault.NODE_RESTARTED,
    }
)
_OTHERS = frozenset(
    {
        Fault.IMU_SILENT,
        Fault.IMU_LOST,
        Fault.IMU_COUNTER,
        Fault.TRACKER_SILENT,
        Fault.TRACKER_LOST,
        Fault.TRACKER_CLOCK,
        Fault.WHEEL_SILENT,
        Fault.THRUSTER_SILENT,
    }
)
_BUS = _NODE | _OTHERS | {Fault.SYNC_LOST, Fault.BUS_SILENT}
# faults that an incident explains, on the same subject or, for a bus, on every device of the bus
EXPLAINS: Mapping[Fault, frozenset[Fault]] = {
    Fault.BUS_OFF: _BUS | {Fault.BUS_ERRORS},
    Fault.BUS_SILENT: _BUS,
    Fault.BUS_BABBLE: frozenset({Fault.JOINT_LATE, Fault.JOINT_LOST}),
    Fault.NODE_UNKNOWN: _NODE,
    Fault.JOINT_SILENT: _NODE | {Fault.ENCODER_JUMP},
    Fault.NODE_RESTARTED: _NODE,
    Fault.NODE_CONTESTED: frozenset({Fault.JOINT_DUPLICATE, Fault.JOINT_LOST, Fault.ENCODER_JUMP}),
    Fault.IMU_SILENT: frozenset(
        {
            Fault.IMU_COUNTER,
            Fault.IMU_START_UP,
            Fault.IMU_LOST,
            Fault.IMU_BYTES_LOST,
            Fault.IMU_NOISE,
            Fault.IMU_JITTER,
        }
    ),
    Fault.TRACKER_SILENT: frozenset(
        {Fault.TRACKER_CLOCK, Fault.TRACKER_LOST, Fault.TRACKER_NOISE, Fault.TRACKER_LATE}
    ),
    Fault.TORQUE_STUCK: frozenset({Fault.TORQUE_INCONSISTENT, Fault.TORQUE_SPIKE}),
    Fault.TORQUE_INCONSISTENT: frozenset({Fault.TORQUE_SPIKE}),
    Fault.GYRO_STUCK: frozenset({Fault.GYRO_INCONSISTENT, Fault.GYRO_SPIKE}),
    Fault.GYRO_INCONSISTENT: frozenset({Fault.GYRO_SPIKE}),
    Fault.ACC_STUCK: frozenset({Fault.ACC_INCONSISTENT, Fault.ACC_SPIKE}),
    Fault.ACC_INCONSISTENT: frozenset({Fault.ACC_SPIKE}),
}
# faults that a stall of the loop explains: those that a clock shows, samples that found no room,
# and the work that has waited
OF_A_STALL = frozenset(
    {
        Fault.LOOP_OVER_BUDGET,
        Fault.SYNC_LOST,
        Fault.BUS_SILENT,
        Fault.JOINT_SILENT,
        Fault.JOINT_LOST,
        Fault.JOINT_LATE,
        Fault.JOINT_ORDER,
        Fault.IMU_SILENT,
        Fault.IMU_LOST,
        Fault.IMU_JITTER,
        Fault.TRACKER_SILENT,
        Fault.TRACKER_LOST,
        Fault.TRACKER_LATE,
        Fault.WHEEL_SILENT,
        Fault.THRUSTER_SILENT,
    }
)
LOOP = "loop"
STALL_EFFECT_NS = 100_000_000  # a finding later than this after a stall has another cause
MOST_STALLS = 64  # most stalls remembered
WINDOWED = frozenset(
    {
        Fault.ENCODER_SPIKE,
        Fault.TORQUE_RANGE,
        Fault.TORQUE_SPIKE,
        Fault.TORQUE_INCONSISTENT,
        Fault.GYRO_SPIKE,
        Fault.GYRO_INCONSISTENT,
        Fault.ACC_SPIKE,
        Fault.ACC_INCONSISTENT,
        Fault.TRACKER_FLIP,
        Fault.TRACKER_JUMP,
    }
)


@dataclass(slots=True)
class _Incident:
    since_ns: int
    last_ns: int
    findings: int
    consequences: dict[Fault, int] = field(default_factory=dict)


class Incidents:
    """Open incidents by fault and subject, and counters by fault.

    Parameters
    ----------
    recover_ns : an incident without a finding for this long is over
    bus_of : name of the bus by name of the device
    window_ns : length of a window plus the lag after which it is judged
    """

    def __init__(self, recover_ns: int, bus_of: Mapping[str, str], window_ns: int) -> None:
        self._recover_ns, self._window_ns = recover_ns, window_ns
        self._bus_of = bus_of
        self._open: dict[tuple[Fault, str], _Incident] = {}
        self.findings = dict.fromkeys(Fault, 0)
        self.incidents = dict.fromkeys(Fault, 0)
        self.consequences = 0
        self._stalls: deque[tuple[int, int]] = deque(maxlen=MOST_STALLS)

    def stalled(self, start_ns: int, end_ns: int, now_ns: int) -> Event | None:
        """Count a stall of the loop, which explains findings in it and shortly after it."""
        self._stalls.append((start_ns, end_ns + STALL_EFFECT_NS))
        text = f"no processor for {(end_ns - start_ns) * 1e-6:.0f} ms"
        return self.take(Finding(end_ns, Fault.LOOP_STALLED, LOOP, text), now_ns)

    def take(self, finding: Finding, now_ns: int) -> Event | None:
        """Count one finding; return the event of the incident that the finding opens, else None."""
        fault, subject, t_ns = finding.fault, finding.subject, finding.t_ns
        cause = self._cause(finding)
        if cause is not None:
            self._explain(cause, fault)
            cause.last_ns = max(cause.last_ns, t_ns)
            return None
        incident = self._open.get((fault, subject))
        if incident is None and self._is_of_a_stall(finding):
            self._explain(self._open.get((Fault.LOOP_STALLED, LOOP)), fault)
            return None
        self.findings[fault] += 1
        if incident is not None:
            incident.findings += 1
            incident.last_ns = max(incident.last_ns, t_ns)
            return None
        self._open[fault, subject] = _Incident(t_ns, t_ns, 1)
        self.incidents[fault] += 1
        text = f"{subject}: {finding.text}" if finding.text else subject
        return Event(now_ns, severity(fault), str(fault), text)

    def advance(self, now_ns: int) -> list[Event]:
        """Close incidents that had no finding for the recovery time; return their events."""
        if not self._open:
            return []
        events = []
        for key, incident in list(self._open.items()):
            fault, subject = key
            wait_ns = self._window_ns if fault in WINDOWED else 0
            if now_ns - incident.last_ns < self._recover_ns + wait_ns:
                continue
            del self._open[key]
            lasted_s = (incident.last_ns - incident.since_ns) * 1e-9
            text = f"{subject}: {fault} over after {lasted_s:.2f} s, {incident.findings} findings"
            if incident.consequences:
                parts = [f"{name} {count}" for name, count in incident.consequences.items()]
                text += f", explains {', '.join(parts)}"
            events.append(Event(now_ns, "info", RECOVERED, text))
        return events

    def is_open(self, fault: Fault, subject: str) -> bool:
        """Return whether an incident is open."""
        return (fault, subject) in self._open

    def status(self) -> dict[str, object]:
        """Return open incidents by subject and the counters that are not zero."""
        faulty: dict[str, list[str]] = {}
        for fault, subject in self._open:
            faulty.setdefault(subject, []).append(fault)
        return {
            "faulty": {subject: sorted(faults) for subject, faults in faulty.items()},
            "incidents": {str(f): n for f, n in self.incidents.items() if n},
            "findings": {str(f): n for f, n in self.findings.items() if n},
            "consequences": self.consequences,
        }

    def _explain(self, cause: _Incident | None, fault: Fault) -> None:
        self.consequences += 1
        if cause is not None:
            cause.consequences[fault] = cause.consequences.get(fault, 0) + 1

    def _is_of_a_stall(self, finding: Finding) -> bool:
        """Return whether a stall explains a finding; the finding does not extend the stall."""
        if finding.fault not in OF_A_STALL:
            return False
        return any(start <= finding.t_ns <= end for start, end in self._stalls)

    def _cause(self, finding: Finding) -> _Incident | None:
        if not self._open:
            return None
        places = (finding.subject, self._bus_of.get(finding.subject, finding.subject))
        for (fault, subject), incident in self._open.items():
            if subject in places and finding.fault in EXPLAINS.get(fault, ()):
                return incident
        return None
