"""The daemon's health: turns findings into events and marks faulty channels of windows.

Only stamped samples and windows decide what the estimator uses, so a replay excludes the same
samples. Silence and overruns, which only a clock shows, make events and nothing else.
"""

from collections.abc import Iterable, Sequence
from typing import Any, Protocol

from fsw.config import Config
from fsw.config.feed import SAMPLES
from fsw.health.censored import CensoredTorques
from fsw.health.incidents import LOOP, Incidents
from fsw.health.rotation import RotationMonitor
from fsw.health.stuck import StuckScreen
from fsw.messages import Event, Samples, Window
from fsw.messages.findings import Fault, Finding, Stall

SLIP_WINDOW_S = 0.5


class Finder(Protocol):
    """A part of the daemon that makes findings."""

    def findings(self) -> Iterable[Finding]:
        """Return the findings since the last call."""
        ...


class Health:
    """Fault detection, isolation and recovery of one daemon."""

    def __init__(self, config: Config, torque_steps_nm: Sequence[float] = ()) -> None:
        """`torque_steps_nm`: resolution of every joint's torque; empty: those of canopen nodes."""
        settings = config.health
        bus_of = {
            own.name: own.bus
            for at, own in config.bus_devices.items()
            if own.bus is not None and (at.startswith("joints.") or own.driver != SAMPLES)
        }
        window_s = config.estimator.window_s + config.estimator.lag_s
        recover_ns, window_ns = round(settings.recover_s * 1e9), round(window_s * 1e9)
        self._incidents = Incidents(recover_ns, bus_of, window_ns)
        self._stuck = StuckScreen(config, torque_steps_nm) if settings.stuck else None
        self._rotation = RotationMonitor(config)
        self._censored = CensoredTorques(config)
        self._slip_ticks = max(1, round(SLIP_WINDOW_S * config.scheduler.tick_rate_hz))
        self._slip_limit = max(1, round(settings.slip_ratio * self._slip_ticks))
        self._slip_start = (0, 0)  # tick index, slips
        self._longest_stall = 0  # slips of the longest stall since then
        self._waiting: list[Finding] = []
        self._events: list[Event] = []

    def screen(self, samples: Samples) -> Samples:
        """Return samples with the values of stuck sensors replaced by NaN."""
        return samples if self._stuck is None else self._stuck.screen(samples)

    def take(self, findings: Iterable[Finding], now_ns: int) -> None:
        """Accept findings in order and keep the events of new incidents."""
        for finding in findings:
            event = self._incidents.take(finding, now_ns)
            if event is not None:
                self._events.append(event)

    def stalled(self, stalls: Iterable[Stall], now_ns: int) -> None:
        """Accept the loop's stalls, before the findings that they explain."""
        for stall in stalls:
            event = self._incidents.stalled(stall.start_ns, stall.end_ns, now_ns)
            self._longest_stall = max(self._longest_stall, stall.slips)
            if event is not None:
                self._events.append(event)

    def over_budget(self, worked_ns: int, now_ns: int) -> None:
        """Accept the longest work of a tick that exceeded the budget [ns]; 0: none did."""
        if worked_ns:
            text = f"{worked_ns * 1e-6:.1f} ms of work in a tick"
            self.take([Finding(now_ns, Fault.LOOP_OVER_BUDGET, LOOP, text)], now_ns)

    def judge(self, window: Window) -> Window:
        """Return the window with implausible channels marked missing; keep the findings."""
        for judge in (self._rotation.judge, self._censored.judge):
            window, findings = judge(window)
            self._waiting += findings
        return window

    def tick(self, index: int, slips: int, now_ns: int) -> None:
        """Accept waiting findings, judge the loop's slips and close incidents that are over."""
        waiting, self._waiting = self._waiting, []
        if self._stuck is not None:
            waiting += self._stuck.take()
        self.take(waiting, now_ns)
        if index - self._slip_start[0] >= self._slip_ticks:
            missed = slips - self._slip_start[1] - self._longest_stall
            self._slip_start, self._longest_stall = (index, slips), 0
            if missed >= self._slip_limit:
                text = f"{missed} of the last {self._slip_ticks} ticks missed"
                self.take([Finding(now_ns, Fault.LOOP_OVERRUN, LOOP, text)], now_ns)
        self._events += self._incidents.advance(now_ns)

    def events(self) -> list[Event]:
        """Return the events since the last call."""
        events, self._events = self._events, []
        return events

    def status(self) -> dict[str, Any]:
        """Return open incidents and counters as plain values."""
        return self._incidents.status()
