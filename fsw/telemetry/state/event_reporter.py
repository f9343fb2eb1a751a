"""Reports events of the telemetry application itself; long bursts are summarised."""

from fsw.telemetry.dictionary.events import SEVERITIES
from fsw.telemetry.ports import Host
from fsw.telemetry.state.summaries import Summaries


class EventReporter:
    """Reports events with the severity that the dictionary gives them."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self.summaries = Summaries()

    def report(self, code: str, text: str) -> bool:
        """Report an event; return False if it was held back for the summary of its burst."""
        passes = self.summaries.passes(code, text, self._host.now_ns())
        if passes:
            self._host.report(SEVERITIES[code], code, text)
        return passes

    def poll(self, now_ns: int) -> None:
        """Report the summaries that are due."""
        for code, text in self.summaries.poll(now_ns):
            self._host.report(SEVERITIES[code], code, text)

    def close(self) -> None:
        """Report a last summary of every burst."""
        for code, text in self.summaries.close():
            self._host.report(SEVERITIES[code], code, text)
