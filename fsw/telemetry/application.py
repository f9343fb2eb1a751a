"""The telemetry application: all its services, in the service process.

`poll` is called several hundred times a second and never waits. The methods named after messages
receive what the loop sends; `Host.forward` carries commands to the loop's command queue.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from fsw.config import Config, TelemetryConfig
from fsw.messages import Block, Estimate, Event
from fsw.messages.commands import Command, JobReport, Reply
from fsw.telemetry.dictionary.codes import RESET_CAUSE, Health, Mode, Table
from fsw.telemetry.link.downlink import Downlink
from fsw.telemetry.link.packets import HEADER_BYTES
from fsw.telemetry.link.security import Security
from fsw.telemetry.link.splitter import Uplinked
from fsw.telemetry.ports import FileDelivery, Host
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.eventing import Eventing
from fsw.telemetry.services.executor import Handler, TelecommandExecutor
from fsw.telemetry.services.filing import Filing
from fsw.telemetry.services.functions import Functions
from fsw.telemetry.services.ground_link import GroundLink
from fsw.telemetry.services.housekeeping import Housekeeping
from fsw.telemetry.services.housekeeping_values import (
    HousekeepingValues,
    recorder_values,
    run_values,
    time_values,
)
from fsw.telemetry.services.local_commands import LocalCommands
from fsw.telemetry.services.long_work import LongWork
from fsw.telemetry.services.loop_commands import LoopCommands
from fsw.telemetry.services.monitors import Monitoring
from fsw.telemetry.services.onboard import OnBoardServices
from fsw.telemetry.services.own_commands import OwnCommands
from fsw.telemetry.services.parameters import Parameters
from fsw.telemetry.services.supervision import Supervision
from fsw.telemetry.services.tables import Tables
from fsw.telemetry.services.time_reports import TimeReports
from fsw.telemetry.services.transfers import Transfers
from fsw.telemetry.state.boot import Boot
from fsw.telemetry.state.command_log import CommandLog
from fsw.telemetry.state.event_reporter import EventReporter
from fsw.telemetry.state.latest_values import LatestValues
from fsw.telemetry.state.mode_machine import ModeMachine
from fsw.telemetry.state.parameter_values import ParameterValues
from fsw.telemetry.state.store import GenerationStore
from fsw.telemetry.tables.content import to_yaml
from fsw.telemetry.tables.effective import BOOT, PARAMETERS
from fsw.telemetry.tables.effects import TableEffects

CRASHED = RESET_CAUSE.value("CRASH")


def build_context(
    config: Config, telemetry: TelemetryConfig, host: Host, *, resume: bool
) -> TelemetryContext:
    """Return the parts that the services share, with the state that earlier runs stored.

    Parameters
    ----------
    config : effective configuration
    telemetry : its section `telemetry`
    resume : this process replaces a service process of the same loop that has died
    """
    base = config.as_read()
    state = config.resolve(config.service.state_directory)
    boot = Boot.begin(GenerationStore(state / BOOT), resume=resume)
    down = Downlink(host.now_ns)
    reporter = EventReporter(host)
    mode_machine = ModeMachine(reporter, safe=telemetry.start_mode == "safe")
    log = CommandLog(state, boot.count, host, config.service.disk_reserve_bytes // 2)
    executor = TelecommandExecutor(mode_machine, down, reporter, log)
    return TelemetryContext(
        host=host,
        config=base,
        config_crc32=config.crc32,
        telemetry=telemetry,
        state=state,
        boot=boot,
        reporter=reporter,
        down=down,
        mode_machine=mode_machine,
        latest=LatestValues(config, host),
        parameters=ParameterValues(base, GenerationStore(state / PARAMETERS)),
        log=log,
        executor=executor,
        loop=LoopCommands(host, executor, mode_machine),
        long_work=LongWork(down, executor),
    )


class TelemetryApplication:
    """Runs telemetry and telecommands: services 1 to 23 of ECSS-E-ST-70-41C.

    Parameters
    ----------
    context : the parts that the services share
    delivery : both directions of file delivery
    security : keys and numbers of the authenticated link; None: all packets are sent in clear
    """

    def __init__(
        self, context: TelemetryContext, delivery: FileDelivery, security: Security | None
    ) -> None:
        self.context, self.mode_machine, self.executor = (
            context,
            context.mode_machine,
            context.executor,
        )
        self.link = GroundLink(
            context.telemetry, context.host, context.down, context.reporter, security
        )
        self.local = LocalCommands(context)
        self.parameters = Parameters(context)
        self.events = Eventing(context)
        self.times = TimeReports(context)
        self.values = HousekeepingValues(context)
        self.housekeeping = Housekeeping(context, self.values)
        self.functions = Functions(context)
        self.monitoring = Monitoring(context, self.values, self.functions)
        self.supervision = Supervision(context, self.functions)
        self.filing = Filing(context)
        self.transfers = Transfers(context, self.filing, delivery)
        effects = TableEffects(context, self.housekeeping, self.monitoring)
        self.tables = Tables(context, effects, self.filing)
        self.monitoring.keep = lambda table: self.tables.replace(
            Table.MONITORS, to_yaml(table.model_dump(mode="json"))
        )
        self.onboard = OnBoardServices(context, self.filing, self.tables, self.link)
        context.down.keep = self.onboard.playback.keep
        self._add_values()
        context.executor.add(self._handlers())

    def _add_values(self) -> None:
        context, latest, values = self.context, self.context.latest, self.values
        values.add(1, partial(run_values, context), self.supervision.values)
        values.add(1, latest.loop, self.executor.values, self.events.values)
        values.add(2, latest.estimates)
        values.add(3, latest.covariance)
        values.add(4, latest.devices)
        values.add(5, latest.job)
        values.add(6, self.tables.values)
        values.add(7, partial(recorder_values, context))
        values.add(8, partial(time_values, context), self.executor.link_values, self.link.values)
        values.add(8, self.transfers.values, self.onboard.schedule.values)

    def open(self) -> None:
        """Open the link and report STARTED; a link that cannot be opened gives an event."""
        self.link.open()
        boot = self.context.boot
        self.context.report("STARTED", boot.text())
        if boot.cause == CRASHED:
            self.supervision.health.set(Health.UNCLEAN_RESTART)

    def poll(self, now_ns: int) -> None:
        """Serve the link, timers and transfers once, without waiting."""
        for item in self.link.received(now_ns):
            self.receive(item, now_ns)
        self.context.long_work.poll()
        self.context.reporter.poll(now_ns)
        self.context.loop.poll()
        self.local.poll(now_ns)
        self.onboard.poll(now_ns)
        self.supervision.poll(now_ns)
        self.monitoring.poll(now_ns)
        self.transfers.poll(now_ns, sending=self.link.has_receiver)
        self.housekeeping.poll(now_ns)
        self.times.poll(now_ns)
        self.link.flush(now_ns)

    def close(self) -> None:
        """Close the link and store that the daemon ended in order, not by a crash."""
        self.context.long_work.close()
        self.link.close()
        self.context.reporter.close()
        if self.link.security is not None:
            self.link.security.close()
        store = GenerationStore(self.context.state / BOOT)
        commanded = self.context.loop.restart_commanded
        self.context.boot.keep(store, running=False, commanded=commanded)

    def state_removed(self) -> None:
        """Make again what must be in the state directory, which was removed."""
        context = self.context
        with suppress(OSError):  # the files of others are made when they are written
            self.filing.make_folder()
        context.boot.keep(GenerationStore(context.state / BOOT), running=True, commanded=False)
        if self.link.security is not None:
            self.link.security.open()

    def files(self) -> list[Path]:
        """Return the paths of the files that grow: logs and packet stores."""
        logs = *self.context.log.files, *self.events.files()
        return [*logs, *self.onboard.playback.files()]

    def summary(self) -> dict[str, Any]:
        """Return link, mode, health, start count and telecommand counters for the status file."""
        return {
            **self.link.summary(),
            "mode": self.mode_machine.mode.name,
            "health": self.supervision.health.latched,
            "boot_count": self.context.boot.count,
            "tc": asdict(self.executor.counters),
        }

    def status(self, status: Mapping[str, Any]) -> None:
        """Record the loop's summary; in SAFE, pause an estimator that still identifies."""
        self.context.latest.record_status(status)
        self.supervision.status()
        if self.mode_machine.mode is Mode.SAFE and status.get("identifying", False):
            self.functions.go_safe()  # a restored state may have been identifying

    def estimate(self, estimate: Estimate) -> None:
        """Record the newest estimate."""
        self.context.latest.estimate = estimate

    def block(self, block: Block) -> None:
        """Compute the torque residuals of a block."""
        self.context.latest.record_block(block)

    def science(self, t_ns: int, record: bytes) -> None:
        """Record the newest samples; `record` holds the packed fields of the science packet."""
        self.housekeeping.science(t_ns, record)

    def event(self, event: Event) -> None:
        """Log and send an event of any part of the daemon, and react to it."""
        self.events.record(event)
        self.supervision.event(event.code)
        self.onboard.event(event.code)

    def reply(self, reply: Reply) -> None:
        """Pass the loop's reply on to the services that wait for the command's end."""
        self.local.reply(reply)
        self.context.loop.reply(reply)

    def job(self, report: JobReport) -> None:
        """Record progress or end of a batch job."""
        self.context.latest.record_job(report)
        self.mode_machine.job(report.state == "running")
        self.context.loop.job(report)

    def local_command(self, command: Command) -> None:
        """Record a command of the local control socket; the loop's reply ends the command."""
        self.local.begin(command)

    def receive(self, item: Uplinked, now_ns: int) -> None:
        """Execute, deliver or reject one packet from the ground."""
        if item.error is not None:
            text = f"{item.text} ({item.source})".strip() if item.source else item.text
            self.executor.refuse(item.packet, item.error, text, item.value)
        elif item.is_file:
            self.transfers.delivery.receive(item.packet[HEADER_BYTES:], now_ns)
        elif self.executor.receive(item.packet, item.source):
            self.supervision.commanded()

    def _handlers(self) -> dict[str, Handler]:
        parts = (
            OwnCommands(self.context, self.link, self.events, self.supervision),
            self.times,
            self.parameters,
            self.events,
            self.housekeeping,
            self.functions,
            self.monitoring,
            self.filing,
            self.transfers,
            self.tables,
            self.onboard,
        )
        return {name: handler for part in parts for name, handler in part.handlers().items()}
