"""Health word, mode, command-loss timer and the loop's silence."""

from __future__ import annotations

from collections.abc import Callable

from fsw.messages.findings import Fault, severity
from fsw.telemetry.dictionary.codes import Health, Mode
from fsw.telemetry.dictionary.housekeeping import SILENT_LEAST_S
from fsw.telemetry.state.health import HealthWord
from fsw.telemetry.state.knowledge import Knowledge
from fsw.telemetry.state.modes import ModeMachine

SILENT_PERIODS = 10.0
FRESH_NS = 10_000_000_000  # a slip or a rejected sample stands for so long
OF_A_BUS = ("SYNC_", "BUS_", "NODE_UNKNOWN")  # faults that are not one sensor's
Report = Callable[[str, str], None]  # event code, text


class Supervision:
    """Watches.

    Parameters
    ----------
    command_loss_s : 0 switches the timer off
    go_safe : the reaction
    """

    def __init__(
        self,
        knowledge: Knowledge,
        modes: ModeMachine,
        now_ns: Callable[[], int],
        status_rate_hz: float,
        command_loss_s: Callable[[], float],
        report: Report,
        go_safe: Callable[[], None],
    ) -> None:
        self._knowledge, self._modes, self._now_ns = knowledge, modes, now_ns
        self._silent_s = max(SILENT_LEAST_S, SILENT_PERIODS / status_rate_hz)
        self._command_loss_s, self._report, self._go_safe = command_loss_s, report, go_safe
        self.health = HealthWord()
        self._mode = modes.mode
        self._commanded_ns = now_ns()
        self._lost = False
        self._silent = False
        self._counted = {Health.SLIPS: 0, Health.SENSOR_REJECTED: 0}
        self._counted_ns = dict.fromkeys(self._counted, -FRESH_NS)

    @property
    def command_loss_left_s(self) -> float:
        """Return the time until the reaction; -1 when the timer is off."""
        limit_s = self._command_loss_s()
        if limit_s <= 0:
            return -1.0
        return max(0.0, limit_s - (self._now_ns() - self._commanded_ns) * 1e-9)

    def commanded(self) -> None:
        """Take an accepted telecommand."""
        self._commanded_ns = self._now_ns()
        if self._lost:
            self._lost = False
            self._report("COMMAND_BACK", "telecommands come again")

    def mode_changed(self) -> None:
        """Tell when the mode is another."""
        mode = self._modes.mode
        if mode is not self._mode:
            before, self._mode = self._mode, mode
            self._report("MODE_CHANGED", f"{before.name} to {mode.name}")

    def heard_status(self) -> None:
        """Take the newest summary."""
        status = self._knowledge.status
        job = status.get("job") or {}
        self._modes.heard(
            identifying=bool(status.get("identifying", True)), job=job.get("state") == "running"
        )
        self.mode_changed()
        if self._silent:
            self._silent = False
            self.health.standing(Health.LOOP_SILENT, present=False)
        rejected = sum(int(s.get("rejected", 0)) for s in status.get("samples", {}).values())
        self._count(Health.SLIPS, int(status.get("slips", 0)))
        self._count(Health.SENSOR_REJECTED, rejected)
        down = any(not link.get("up", True) for link in status.get("links", {}).values())
        self._stands(Health.PORT_LOST, down)
        faulty = status.get("health", {}).get("faulty", {})
        faults = {f for found in faulty.values() for f in found if severity(Fault(f)) != "low"}
        on_buses = {fault for fault in faults if fault.startswith(OF_A_BUS)}
        self._stands(Health.BUS, bool(on_buses))
        self._stands(Health.SENSOR_FAULT, bool(faults - on_buses - {Fault.LOOP_OVERRUN}))

    def event(self, code: str) -> None:
        """Take an event's code: it may set a bit."""
        self._tell(self.health.event(code))

    def poll(self, now_ns: int) -> None:
        """Look at the timers."""
        for bit, counted_ns in self._counted_ns.items():
            self._stands(bit, now_ns - counted_ns < FRESH_NS)
        if not self._silent and self._modes.mode is not Mode.BOOT:
            age_s = self._knowledge.summary_age_s
            if age_s > self._silent_s:
                self._silent = True
                self.health.standing(Health.LOOP_SILENT, present=True)
                self._report("LOOP_SILENT", f"no summary for {age_s:.1f} s")
        if not self._lost and self.command_loss_left_s == 0.0:
            self._lost = True
            self._report("COMMAND_LOSS", f"no telecommand for {self._command_loss_s():.0f} s")
            self._go_safe()

    def _count(self, bit: Health, count: int) -> None:
        """Remember when a counter was last seen to grow."""
        if count > self._counted[bit]:
            self._counted_ns[bit] = self._now_ns()
        self._counted[bit] = count

    def _stands(self, bit: Health, present: bool) -> None:
        self._tell(self.health.standing(bit, present))

    def _tell(self, mask: int) -> None:
        if mask:
            names = [bit.name for bit in Health if mask >> bit & 1]
            self._report("HEALTH_LATCHED", ", ".join(names))
