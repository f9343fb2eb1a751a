"""Losses between two accepted frames of a serial device, judged only by counts.

The device's counter gives the missing datagrams, the framer gives the bytes in no frame. A damaged
datagram leaves all its bytes, a datagram that lost bytes leaves fewer, and junk misses no datagram.
"""

from collections import deque
from typing import NamedTuple

from fsw.messages.findings import Fault, Finding

ESCAPED_RATIO = 1.2  # escapes lengthen a frame by less than this
MAX_FINDINGS = 1024  # kept until `take`; the oldest are discarded
REPEAT_NS = 100_000_000  # a silence that continues is reported again after this time
START_NS = 5_000_000_000  # a device may take this long from the opened port to its first frame


class LineFaults(NamedTuple):
    """Code for each fault of the data that one device, or one sender, sends."""

    silent: Fault
    lost: Fault
    bytes_lost: Fault
    damaged: Fault
    noise: Fault
    doubled: Fault
    order: Fault
    clock: Fault
    late: Fault
    restarted: Fault


IMU_LINE = LineFaults(
    Fault.IMU_SILENT,
    Fault.IMU_LOST,
    Fault.IMU_BYTES_LOST,
    Fault.IMU_CRC,
    Fault.IMU_NOISE,
    Fault.IMU_DUPLICATE,
    Fault.IMU_COUNTER,
    Fault.IMU_COUNTER,
    Fault.IMU_JITTER,
    Fault.IMU_COUNTER,
)
TRACKER_LINE = LineFaults(
    Fault.TRACKER_SILENT,
    Fault.TRACKER_LOST,
    Fault.TRACKER_DAMAGED,
    Fault.TRACKER_DAMAGED,
    Fault.TRACKER_NOISE,
    Fault.TRACKER_DUPLICATE,
    Fault.TRACKER_CLOCK,
    Fault.TRACKER_CLOCK,
    Fault.TRACKER_LATE,
    Fault.TRACKER_CLOCK,
)


def silent_only(fault: Fault) -> LineFaults:
    """Return the codes for a device of which only silence is reported: all are `fault`."""
    return LineFaults(*[fault] * len(LineFaults._fields))


class LineWatch:
    """Finds faults of one serial line.

    Parameters
    ----------
    faults : codes of the faults
    subject : name of the device
    period_ns : nominal time between frames
    silent_periods : the line is silent after this many periods without a frame
    """

    def __init__(
        self, faults: LineFaults, subject: str, period_ns: float, silent_periods: float
    ) -> None:
        self._faults, self._subject = faults, subject
        self._silent_periods = silent_periods
        self._silent_ns = round(silent_periods * period_ns)
        self._last_ns: int | None = None  # of a frame; None: there is none since the port's opening
        self._opened_ns: int | None = None
        self._reported_ns = 0
        self._skipped = 0
        self._refused = 0
        self._excused = False  # missing frames are explained: there was no port
        self._found: deque[Finding] = deque(maxlen=MAX_FINDINGS)

    def take(self) -> list[Finding]:
        """Return the findings since the last call."""
        found = list(self._found)
        self._found.clear()
        return found

    def find(self, t_ns: int, fault: Fault, text: str = "") -> None:
        """Add a finding about the device."""
        self._found.append(Finding(t_ns, fault, self._subject, text))

    def refused(self, t_ns: int, skipped: int) -> None:
        """Count an intact frame that was not used, and the bytes skipped before it."""
        if self._last_ns is None:
            self._opened_ns = t_ns
        else:  # a line that sends refused frames is not silent
            self._last_ns = t_ns
        self._refused += 1
        self._skipped += skipped

    @property
    def is_clean(self) -> bool:
        """Whether nothing was skipped, refused or excused since the last accepted frame."""
        return not (self._skipped or self._refused or self._excused)

    def followed(self, t_ns: int) -> None:
        """Record that frames up to a time were accepted without a gap or junk between them."""
        self._last_ns = t_ns

    def accepted(self, t_ns: int, skipped: int, lost: int, length: int) -> None:
        """Record an accepted frame.

        Parameters
        ----------
        skipped : bytes in no frame since the frame before
        lost : frames missing by the device's counter since the last accepted one
        length : length of a frame [bytes]
        """
        skipped, self._skipped = skipped + self._skipped, 0
        missing, self._refused = lost - self._refused, 0
        self._last_ns = t_ns
        if self._excused:
            self._excused = False
        elif missing <= 0:
            if skipped:
                self.find(t_ns, self._faults.noise, f"{skipped} bytes of no frame")
        elif not skipped:
            silent = missing >= self._silent_periods
            fault = self._faults.silent if silent else self._faults.lost
            self.find(t_ns, fault, f"{missing} frames missing")
        elif skipped < missing * length:
            text = f"{missing * length - skipped} bytes missing of {missing} frames"
            self.find(t_ns, self._faults.bytes_lost, text)
        elif skipped <= ESCAPED_RATIO * missing * length:
            self.find(t_ns, self._faults.damaged, f"{missing} frames damaged")
        else:
            self.find(t_ns, self._faults.noise, f"{skipped} bytes of no frame")

    def watch(self, now_ns: int, *, up: bool, words: str = "") -> None:
        """Report the line if it is silent; without its port (not `up`) it is not judged.

        `words` say what the frames lack if none has been usable so far; the report includes them.
        """
        if not up:
            self._last_ns, self._opened_ns, self._excused = None, None, True
            return
        if self._opened_ns is None:
            self._opened_ns = now_ns
        since_ns, silent_ns = self._last_ns, self._silent_ns
        if since_ns is None:
            since_ns, silent_ns = self._opened_ns, max(START_NS, self._silent_ns)
        if now_ns - since_ns < silent_ns or now_ns - self._reported_ns < REPEAT_NS:
            return
        self._reported_ns = now_ns
        text = f"nothing usable for {(now_ns - since_ns) * 1e-9:.3f} s"
        self.find(now_ns, self._faults.silent, f"{text}; {words}" if words else text)
