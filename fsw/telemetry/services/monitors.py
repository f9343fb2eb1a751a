"""Service 12: monitors check telemetered values against limits and may act once."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from typing import Any

from pydantic import ValidationError

from fsw.config.tables import MAX_MONITORS, MonitorConfig, MonitorsTable
from fsw.errors import ConfigError
from fsw.telemetry.dictionary.codes import MONITOR_ACTION, Error
from fsw.telemetry.dictionary.onboard_commands import LARGEST
from fsw.telemetry.dictionary.parameters import VALUE
from fsw.telemetry.link.telecommands import Request, TcError
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.executor import Action, Done, Handler, each
from fsw.telemetry.services.functions import Functions
from fsw.telemetry.services.housekeeping_values import HousekeepingValues
from fsw.telemetry.services.long_work import Pieces

PERIOD_NS = 200_000_000
NUMBERS = {label: number for number, label in VALUE.labels.items()}


class Check(IntEnum):
    """Result of a check; the names are those of the dictionary's labels."""

    UNCHECKED = 0
    WITHIN = 1
    BELOW_LOW = 2
    ABOVE_HIGH = 3
    STALE = 4


@dataclass(slots=True)
class _Monitor:
    config: MonitorConfig
    status: Check = Check.UNCHECKED
    candidate: Check = Check.UNCHECKED
    count: int = 0
    acted: bool = False

    @property
    def enabled(self) -> bool:
        """Return whether the monitor is checked."""
        return self.config.enabled


def check_table(table: MonitorsTable) -> None:
    """Raise ConfigError if a monitor names a value that telemetry does not contain."""
    unknown = [m.value for m in table.monitors if m.value not in NUMBERS]
    if unknown:
        raise ConfigError(f"monitors.value: {unknown} are not numbers of the housekeeping sets")


class Monitoring:
    """Checks values five times a second.

    Parameters
    ----------
    values : source of the telemetered values
    functions : carries out the action of a monitor

    Attributes
    ----------
    keep : writes a table to the disk; if it raises TcError, the table before stays in use
    """

    def __init__(
        self, context: TelemetryContext, values: HousekeepingValues, functions: Functions
    ) -> None:
        self._context, self._values, self._functions = context, values, functions
        self._monitors: dict[int, _Monitor] = {}
        self._due_ns = 0
        self.enabled = True
        self.keep: Callable[[MonitorsTable], None] = lambda _: None

    def apply(self, table: MonitorsTable) -> None:
        """Use another table; every status begins again as UNCHECKED."""
        self._monitors = {m.id: _Monitor(m) for m in table.monitors}

    def table(self) -> list[dict[str, Any]]:
        """Return the monitors in the form of a monitors table."""
        return [m.config.model_dump(mode="json") for m in self._monitors.values()]

    def poll(self, now_ns: int) -> None:
        """Check all enabled monitors, if `PERIOD_NS` has passed since the last check."""
        if not self.enabled or now_ns < self._due_ns:
            return
        self._due_ns = now_ns + PERIOD_NS
        seen: dict[str, tuple[Mapping[str, Any], float]] = {}
        for monitor in self._monitors.values():
            if monitor.enabled:
                packet, name = monitor.config.value.split(".")
                if packet not in seen:
                    seen[packet] = self._values.watched(packet)
                values, age_s = seen[packet]
                self._check(monitor, float(values[name]), age_s)

    def _check(self, monitor: _Monitor, value: float, age_s: float) -> None:
        found = _judge(monitor.config, value, age_s)
        monitor.count = monitor.count + 1 if found is monitor.candidate else 1
        monitor.candidate = found
        needed = 1 if found is Check.WITHIN else monitor.config.repetitions
        if found is monitor.status or monitor.count < needed:
            return
        before, monitor.status = monitor.status, found
        if before is Check.UNCHECKED and found is Check.WITHIN:
            return
        self._transition(monitor, before, value, age_s)

    def _transition(self, monitor: _Monitor, before: Check, value: float, age_s: float) -> None:
        config, now = monitor.config, monitor.status
        limit = {Check.ABOVE_HIGH: config.high, Check.STALE: config.stale_s}.get(now, config.low)
        values = {
            "n": 1,
            "monitor": config.id,
            "value": NUMBERS[config.value],
            "found": age_s if now is Check.STALE else value,
            "limit": limit or 0.0,
            "before": int(before),
            "now": int(now),
            "time_s": self._context.now_ns() * 1e-9,
        }
        self._context.down.send("check_transition", values)
        words = f"monitor {config.id}: {config.value} {now.name}, {value:.6g}"
        if now is Check.WITHIN:
            self._context.report("LIMIT_RECOVERED", words)
            return
        self._context.report("LIMIT_VIOLATED", words)
        if config.action != "none" and not monitor.acted:
            monitor.acted = True
            self._context.report("LIMIT_ACTION", f"monitor {config.id}: {config.action}")
            self._functions.act(config.action, f"monitor {config.id}")

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers of this service's telecommands."""
        return {
            "ENABLE_MONITOR": each(partial(self._switch, enabled=True)),
            "DISABLE_MONITOR": each(partial(self._switch, enabled=False)),
            "ADD_MONITOR": self._add,
            "DELETE_MONITOR": self._delete,
            "MODIFY_MONITOR": self._modify,
            "REPORT_MONITOR": each(self._report_definition),
            "REPORT_MONITOR_STATUS": partial(self._context.long_work.action, make=self._status),
            "ENABLE_MONITORING": lambda _: partial(self._switch_all, enabled=True),
            "DISABLE_MONITORING": lambda _: partial(self._switch_all, enabled=False),
        }

    def _find(self, request: Request) -> _Monitor:
        monitor = self._monitors.get(request.whole("monitor"))
        if monitor is None:
            raise TcError(Error.BAD_ARG, 1, request.number("monitor"), "no such monitor")
        return monitor

    def _switch(self, request: Request, *, enabled: bool) -> Action:
        config = self._find(request).config.model_copy(update={"enabled": enabled})
        return partial(self._change, config.id, config)

    def _add(self, request: Request) -> Action:
        config = _requested(request, enabled=False)
        if config.id in self._monitors:
            raise TcError(Error.BAD_ARG, 2, config.id, "there is a monitor of this number")
        if len(self._monitors) >= MAX_MONITORS:
            raise TcError(Error.BUSY, 2, MAX_MONITORS, "no place for another monitor")
        return partial(self._change, config.id, config)

    def _modify(self, request: Request) -> Action:
        config = _requested(request, enabled=self._find(request).enabled)
        return partial(self._change, config.id, config)

    def _delete(self, request: Request) -> Action:
        monitor = self._find(request)
        if monitor.enabled:
            raise TcError(Error.BUSY, 2, monitor.config.id, "it is enabled")
        return partial(self._change, monitor.config.id, None)

    def _change(self, number: int, config: MonitorConfig | None) -> Done:
        """Store a table with one monitor changed or removed (None), then use the table."""
        monitors = {key: m for key, m in self._monitors.items() if key != number or config}
        if config is not None:
            monitors[number] = _Monitor(config)
        self.keep(MonitorsTable(monitors=tuple(m.config for m in monitors.values())))
        self._monitors = monitors
        return Done.NOW

    def _switch_all(self, *, enabled: bool) -> Done:
        self.enabled = enabled
        return Done.NOW

    def _report_definition(self, request: Request) -> Action:
        monitor = self._find(request)

        def act() -> Done:
            config = monitor.config
            values = {
                "n": 1,
                "monitor": config.id,
                "value": NUMBERS[config.value],
                "enabled": monitor.enabled,
                "low": float("-inf") if config.low is None else config.low,
                "high": float("inf") if config.high is None else config.high,
                "repetitions": config.repetitions,
                "stale_s": config.stale_s,
                "action": config.action,
            }
            self._context.down.send("monitor_definition", values)
            return Done.NOW

        return act

    def _status(self) -> Pieces:
        if not self._monitors:
            yield "monitor_status", {"n": 0, "monitor": 0, "enabled": False, "status": 0}
        for number, monitor in self._monitors.items():
            values = {"monitor": number, "enabled": monitor.enabled, "status": int(monitor.status)}
            yield "monitor_status", {"n": 1} | values


def _requested(request: Request, *, enabled: bool) -> MonitorConfig:
    """Return the monitor's definition in a telecommand. Raises TcError."""
    low, high = request.number("low"), request.number("high")
    action = request.whole("action")
    try:
        return MonitorConfig.model_validate(
            {
                "id": request.whole("monitor"),
                "value": VALUE.labels[request.whole("value")],
                "low": None if low <= -LARGEST else low,
                "high": None if high >= LARGEST else high,
                "repetitions": request.whole("repetitions"),
                "stale_s": request.number("stale_s"),
                "enabled": enabled,
                "action": MONITOR_ACTION.labels[action].lower(),
            }
        )
    except ValidationError as error:
        raise TcError(Error.BAD_ARG, 5, low, str(error.errors()[0]["msg"])) from error


def _judge(config: MonitorConfig, value: float, age_s: float) -> Check:
    if 0 < config.stale_s < age_s:
        return Check.STALE
    if config.low is not None and value < config.low:
        return Check.BELOW_LOW
    if config.high is not None and value > config.high:
        return Check.ABOVE_HIGH
    return Check.WITHIN
