"""The parts of the telemetry application that every service shares."""

from dataclasses import dataclass
from pathlib import Path

from fsw.config import Config, TelemetryConfig
from fsw.telemetry.link.downlink import Downlink
from fsw.telemetry.ports import Host
from fsw.telemetry.services.executor import TelecommandExecutor
from fsw.telemetry.services.long_work import LongWork
from fsw.telemetry.services.loop_commands import LoopCommands
from fsw.telemetry.state.boot import Boot
from fsw.telemetry.state.command_log import CommandLog
from fsw.telemetry.state.epoch import Epoch
from fsw.telemetry.state.event_reporter import EventReporter
from fsw.telemetry.state.latest_values import LatestValues
from fsw.telemetry.state.mode_machine import ModeMachine
from fsw.telemetry.state.parameter_values import ParameterValues


@dataclass(frozen=True, slots=True, kw_only=True)
class TelemetryContext:
    """Holds the parts of the application that every service may use.

    Parameters
    ----------
    host : the service process around the application
    config : configuration as read from its file, without tables and parameters
    config_crc32 : CRC-32 of the effective configuration at the start
    telemetry : its section `telemetry`
    state : directory of all files that must survive a restart
    boot : number and cause of this start
    reporter : reports events
    down : sends packets
    mode_machine : returns and changes the mode
    latest : newest values from the loop, and the effective configuration
    parameters : on-board parameters
    log : log of commands
    executor : checks, executes and completes telecommands
    loop : sends commands to the loop process
    long_work : sends long answers and works on files, in pieces
    """

    host: Host
    config: Config
    config_crc32: int
    telemetry: TelemetryConfig
    state: Path
    boot: Boot
    reporter: EventReporter
    down: Downlink
    mode_machine: ModeMachine
    latest: LatestValues
    parameters: ParameterValues
    log: CommandLog
    executor: TelecommandExecutor
    loop: LoopCommands
    long_work: LongWork

    def now_ns(self) -> int:
        """Return mission elapsed time [ns]."""
        return self.host.now_ns()

    def epoch(self) -> Epoch:
        """Return the origin of mission elapsed time."""
        return self.host.epoch()

    def unix_s(self) -> float:
        """Return the time of day [s]."""
        return (self.host.now_ns() + self.host.epoch().utc_less_met_ns) * 1e-9

    @property
    def reserve_bytes(self) -> int:
        """Return the free space of the disk that files leave alone [B]."""
        return self.config.service.disk_reserve_bytes

    def report(self, code: str, text: str) -> None:
        """Report an event of the application; a burst may be reduced to summaries."""
        self.reporter.report(code, text)

    def parameter(self, name: str) -> float:
        """Return the value in use of an on-board parameter."""
        return self.parameters.get(name)
