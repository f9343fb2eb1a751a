"""Supervises health word, mode, command-loss timer and the loop's silence."""

from fsw.messages.findings import Fault, severity
from fsw.telemetry.dictionary.codes import Health, Mode
from fsw.telemetry.dictionary.housekeeping import SILENT_LEAST_S
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.functions import Functions
from fsw.telemetry.state.health import HealthWord

SILENT_PERIODS = 10.0
FRESH_NS = 10_000_000_000  # time for which a slip or a rejected sample counts as present
OF_THE_LOOP = {Fault.LOOP_OVERRUN, Fault.LOOP_STALLED, Fault.LOOP_OVER_BUDGET}
OF_A_BUS = ("SYNC_", "BUS_", "NODE_UNKNOWN")  # prefixes of faults of a whole bus


class Supervision:
    """Keeps the health word and raises LOOP_SILENT and COMMAND_LOSS.

    Parameters
    ----------
    functions : enters SAFE when the ground has been silent for too long
    """

    def __init__(self, context: TelemetryContext, functions: Functions) -> None:
        self._context, self._functions = context, functions
        self._silent_s = max(SILENT_LEAST_S, SILENT_PERIODS / context.config.service.status_rate_hz)
        self.health = HealthWord()
        self._commanded_ns = context.now_ns()
        self._lost = False
        self._silent = False
        self._counted = {Health.SLIPS: 0, Health.SENSOR_REJECTED: 0}
        self._counted_ns = dict.fromkeys(self._counted, -FRESH_NS)

    @property
    def command_loss_left_s(self) -> float:
        """Return the time until the command-loss reaction [s]; -1 if the timer is off."""
        limit_s = self._context.parameter("command_loss_time_s")
        if limit_s <= 0:
            return -1.0
        return max(0.0, limit_s - (self._context.now_ns() - self._commanded_ns) * 1e-9)

    def commanded(self) -> None:
        """Restart the command-loss timer, because a telecommand was accepted."""
        self._commanded_ns = self._context.now_ns()
        if self._lost:
            self._lost = False
            self._context.report("COMMAND_BACK", "telecommands come again")

    def values(self) -> dict[str, object]:
        """Return the health word and the command-loss timer for housekeeping set 1."""
        return {
            "health": self.health.latched,
            "health_now": self.health.now,
            "command_loss_left_s": self.command_loss_left_s,
        }

    def status(self) -> None:
        """Set mode and health bits by the loop's newest summary."""
        status = self._context.latest.status
        job = status.get("job") or {}
        self._context.mode_machine.summary(
            identifying=bool(status.get("identifying", True)), job=job.get("state") == "running"
        )
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
        self._stands(Health.SENSOR_FAULT, bool(faults - on_buses - OF_THE_LOOP))

    def event(self, code: str) -> None:
        """Set or clear the bit of the health word that belongs to an event."""
        self._report_bits(self.health.event(code))

    def poll(self, now_ns: int) -> None:
        """Check the age of counted faults, the loop's silence and the command-loss timer."""
        for bit, counted_ns in self._counted_ns.items():
            self._stands(bit, now_ns - counted_ns < FRESH_NS)
        if not self._silent and self._context.mode_machine.mode is not Mode.BOOT:
            age_s = self._context.latest.summary_age_s
            if age_s > self._silent_s:
                self._silent = True
                self.health.standing(Health.LOOP_SILENT, present=True)
                self._context.report("LOOP_SILENT", f"no summary for {age_s:.1f} s")
        if not self._lost and self.command_loss_left_s == 0.0:
            self._lost = True
            self._context.report(
                "COMMAND_LOSS",
                f"no telecommand for {self._context.parameter('command_loss_time_s'):.0f} s",
            )
            self._functions.act("safe", "command-loss timer")

    def _count(self, bit: Health, count: int) -> None:
        """Record a counter, and the time at which it was last seen to grow."""
        if count > self._counted[bit]:
            self._counted_ns[bit] = self._context.now_ns()
        self._counted[bit] = count

    def _stands(self, bit: Health, present: bool) -> None:
        self._report_bits(self.health.standing(bit, present))

    def _report_bits(self, mask: int) -> None:
        if mask:
            names = [bit.name for bit in Health if mask >> bit & 1]
            self._context.report("HEALTH_LATCHED", ", ".join(names))
