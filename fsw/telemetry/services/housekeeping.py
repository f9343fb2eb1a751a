"""Service 3: housekeeping sets, sent periodically or once, and science packets."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from fsw.config.tables import RatesTable
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.dictionary.housekeeping import SCIENCE, SCIENCE_SID, SET_NAMES
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.executor import Action, Done, Handler, each
from fsw.telemetry.services.housekeeping_values import HousekeepingValues

SLOW_SETS = (3, 6, 7)
SLOW_FACTOR = 5
FALLBACK_S = 1.0  # interval of a set that is disabled by the configured interval 0
MS = 1_000_000
_SID_BYTES = SCIENCE_SID.to_bytes(2, "big")


@dataclass(slots=True)
class _Rate:
    interval_ns: int
    enabled: bool
    due_ns: int = 0


class Housekeeping:
    """Sends each set at its own rate."""

    def __init__(self, context: TelemetryContext, values: HousekeepingValues) -> None:
        self._context, self._values = context, values
        config = context.telemetry
        self._rates: dict[int, _Rate] = {}
        for sid in SET_NAMES:
            factor = SLOW_FACTOR if sid in SLOW_SETS else 1
            self._rates[sid] = _rate(factor * config.housekeeping_interval_s)
        self._rates[SCIENCE_SID] = _rate(config.science_interval_s)
        self._science_rate_hz = config.science_rate_hz
        self._science: tuple[int, bytes] | None = None

    def poll(self, now_ns: int) -> None:
        """Send every set that is due; sets missed before are not sent."""
        for sid in SET_NAMES:
            rate = self._rates[sid]
            if rate.enabled and now_ns >= rate.due_ns:
                rate.due_ns = _next(rate, now_ns)
                self.report(sid)

    def science(self, t_ns: int, record: bytes) -> None:
        """Record the newest samples; send them if the science packet is due."""
        self._science = (t_ns, record)
        rate = self._rates[SCIENCE_SID]
        # half a millisecond early counts as due, because the loop's grid jitters
        if rate.enabled and t_ns + MS // 2 >= rate.due_ns:
            rate.due_ns = _next(rate, t_ns)
            self.report(SCIENCE_SID)

    def report(self, sid: int) -> None:
        """Send one set now; the science set with its newest samples, if there are any."""
        if sid != SCIENCE_SID:
            self._context.down.send(SET_NAMES[sid], self._values.of(sid))
        elif self._science is not None:
            t_ns, record = self._science
            self._context.down.wrap(SCIENCE, t_ns, _SID_BYTES + record)

    def apply(self, table: RatesTable) -> None:
        """Use the rates of a table from now on."""
        for sid, item in table.sets.items():
            self._rates[sid] = _Rate(round(item.interval_s * 1e9), item.enabled)

    def rates(self) -> dict[int, dict[str, Any]]:
        """Return the rates in the form of a rates table, by set number."""
        return {
            sid: {"interval_s": rate.interval_ns * 1e-9, "enabled": rate.enabled}
            for sid, rate in self._rates.items()
        }

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers of this service's telecommands."""
        return {
            "ENABLE_SET": each(partial(self._switch, enabled=True)),
            "DISABLE_SET": each(partial(self._switch, enabled=False)),
            "REPORT_SET": each(lambda request: partial(self._once, request.whole("sid"))),
            "SET_INTERVAL": each(self._set_interval),
            "REPORT_SET_PROPERTIES": each(lambda r: partial(self._properties, r.whole("sid"))),
        }

    def _switch(self, request: Request, *, enabled: bool) -> Action:
        def act() -> Done:
            rate = self._rates[request.whole("sid")]
            rate.enabled, rate.due_ns = enabled, 0
            return Done.NOW

        return act

    def _once(self, sid: int) -> Done:
        self.report(sid)
        return Done.NOW

    def _set_interval(self, request: Request) -> Action:
        sid, interval_ms = request.whole("sid"), request.whole("interval_ms")
        fault = science_fault({sid: interval_ms * 1e-3}, self._science_rate_hz)
        if fault:
            raise TcError(Error.OUT_OF_RANGE, 2, interval_ms, fault)

        def act() -> Done:
            rate = self._rates[sid]
            rate.interval_ns, rate.due_ns = MS * interval_ms, 0
            return Done.NOW

        return act

    def _properties(self, sid: int) -> Done:
        rate = self._rates[sid]
        values = {"periodic": rate.enabled, "interval_ms": rate.interval_ns // MS}
        self._context.down.send("set_properties", {"n": 1, "sid": sid} | values)
        return Done.NOW


def science_fault(intervals_s: Mapping[int, float], rate_hz: float) -> str:
    """Return why a science packet cannot be sent at its interval; empty if it can."""
    interval_s = intervals_s.get(SCIENCE_SID)
    if interval_s is None or interval_s >= (1.0 - 1e-9) / rate_hz:
        return ""
    return f"set {SCIENCE_SID}: {interval_s:g} s; telemetry.science_rate_hz gives {1 / rate_hz:g} s"


def _rate(interval_s: float) -> _Rate:
    return _Rate(round((interval_s or FALLBACK_S) * 1e9), interval_s > 0)


def _next(rate: _Rate, now_ns: int) -> int:
    """Return the next time of the set's grid after now; begin a new grid if it is too old."""
    if rate.due_ns == 0 or now_ns - rate.due_ns > 10 * rate.interval_ns:
        return now_ns + rate.interval_ns
    missed = (now_ns - rate.due_ns) // rate.interval_ns
    return rate.due_ns + (1 + missed) * rate.interval_ns
