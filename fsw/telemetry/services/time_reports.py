"""Service 9: time packets every 2^exponent seconds, each followed by the UTC correlation.

The time code of packets is mission elapsed time, which no source of UTC adjusts. Ground tools
convert it to UTC by the correlation.
"""

from datetime import UTC, datetime, timedelta

from fsw.telemetry.link.telecommands import Request
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.executor import Action, Done, Handler
from fsw.telemetry.state.epoch import Epoch

SECOND_NS = 1_000_000_000
STAMP_NS = 60  # 2^-24 s, the resolution of a packet's time stamp
UNIX = datetime(1970, 1, 1, tzinfo=UTC)


class TimeReports:
    """Sends time packets when they are due."""

    def __init__(self, context: TelemetryContext) -> None:
        self._context = context
        self._due_ns = 0
        self._commanded: int | None = None

    @property
    def exponent(self) -> int:
        """Return the exponent in use: the commanded one, or else the parameter's."""
        if self._commanded is not None:
            return self._commanded
        return int(self._context.parameter("time_report_exponent"))

    def poll(self, now_ns: int) -> None:
        """Send a time packet and its correlation if they are due."""
        if now_ns >= self._due_ns:
            self._due_ns = now_ns + (SECOND_NS << self.exponent)
            self._context.down.time(self.exponent)
            values = correlation_values(self._context.epoch(), now_ns)
            self._context.down.send("time_correlation", values, now_ns)

    def handlers(self) -> dict[str, Handler]:
        """Return the handler of this service's telecommand."""
        return {"SET_TIME_REPORT_RATE": self._set}

    def _set(self, request: Request) -> Action:
        def act() -> Done:
            self._commanded, self._due_ns = request.whole("exponent"), 0
            return Done.NOW

        return act


def correlation_values(epoch: Epoch, t_ns: int) -> dict[str, object]:
    """Return the fields of the packet time_correlation at a mission elapsed time [ns]."""
    origin = UNIX + timedelta(microseconds=epoch.utc_less_met_ns // 1000)
    return {
        "utc_unix_ns": t_ns + epoch.utc_less_met_ns,
        "uncertainty_s": (epoch.uncertainty_ns + STAMP_NS) * 1e-9,
        "synchronised": epoch.synchronised,
        "epoch_utc": origin.isoformat(timespec="microseconds").replace("+00:00", "Z"),
    }
