"""The telemetry application: its services put together, in the service process.

`poll` is called some hundred times a second and never waits. What comes from the loop arrives by
the methods of a sink; what goes to it goes by `Host.forward` into the one command queue.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from fsw.config import Config, TelemetryConfig
from fsw.messages import Block, Estimate, Event
from fsw.messages.commands import Command, CommandName, JobReport, Reply
from fsw.messages.errors import PortError
from fsw.telemetry.dictionary.codes import (
    RESET_CAUSE,
    CommandOutcome,
    Error,
    Health,
    Mode,
    Table,
)
from fsw.telemetry.link.downlink import Downlink
from fsw.telemetry.link.packets import HEADER_BYTES, Packetizer
from fsw.telemetry.link.security import Security
from fsw.telemetry.link.server import LinkServer
from fsw.telemetry.link.splitter import Uplinked
from fsw.telemetry.link.uplink import ClearUplink, LookUplink, SecureUplink, Uplink
from fsw.telemetry.ports import FileDelivery, Host
from fsw.telemetry.services.context import TelemetryContext
from fsw.telemetry.services.dumps import Dumps
from fsw.telemetry.services.eventing import IDS, SEVERITIES, Eventing
from fsw.telemetry.services.executor import Handler, TcDispatcher
from fsw.telemetry.services.filing import filing_of
from fsw.telemetry.services.functions import Functions
from fsw.telemetry.services.housekeeping import Housekeeping
from fsw.telemetry.services.loop_commands import LoopCommands
from fsw.telemetry.services.monitors import Monitoring
from fsw.telemetry.services.onboard import OnBoardServices
from fsw.telemetry.services.own_commands import OwnCommands
from fsw.telemetry.services.parameters import Parameters
from fsw.telemetry.services.playback import Outlet
from fsw.telemetry.services.summaries import Summaries
from fsw.telemetry.services.tables import Tables
from fsw.telemetry.services.time_reports import TimeReports
from fsw.telemetry.services.transfers import Transfers
from fsw.telemetry.state.boot import Boot
from fsw.telemetry.state.command_log import CommandLog, CommandRecord
from fsw.telemetry.state.knowledge import Knowledge
from fsw.telemetry.state.modes import ModeMachine
from fsw.telemetry.state.sets import Sets
from fsw.telemetry.state.store import GenerationStore
from fsw.telemetry.state.supervision import Supervision
from fsw.telemetry.tables.content import to_yaml
from fsw.telemetry.tables.effective import BOOT, PARAMETERS, TABLES
from fsw.telemetry.tables.effects import TableEffects

MAX_LOCAL = 64  # commands of the local socket whose reply is waited for
MAX_ITEMS = 64  # packets that come up are looked at in one poll,
MAX_WORK_NS = 20_000_000  # and for no longer than this, one command excepted
CRASHED = RESET_CAUSE.value("CRASH")
NO_LINK_ROOM_BYTES = 1 << 16  # nothing waits where there is no link


class TelemetryApplication:
    """Telemetry, telecommands and everything of service 1 to 23.

    Parameters
    ----------
    config : in force, the telemetry section included
    base : as it was read, nothing laid over
    security : of the authenticated link; None: telecommands and telemetry in clear
    resume : this service process goes on where one of the same loop has died
    """

    def __init__(
        self,
        config: Config,
        base: Config,
        telemetry: TelemetryConfig,
        host: Host,
        *,
        security: Security | None = None,
        resume: bool = False,
    ) -> None:
        self._telemetry, self.host = telemetry, host
        self.security = security
        self.summaries = Summaries()
        self.delivery: FileDelivery | None = None
        self.config_crc32 = config.crc32
        self.state = state = config.resolve(config.service.state_directory)
        self._boot_store = GenerationStore(state / BOOT)
        self.boot = Boot.begin(self._boot_store, resume=resume)
        self.down = Downlink(host.now_ns)
        self.link: LinkServer | None = None
        self._refusals = Packetizer()  # counts of its own: these packets go to one client only
        self._restart = False
        self._local: dict[int, CommandRecord] = {}  # commands of the local socket, by their id
        self.modes = ModeMachine(safe=telemetry.start_mode == "safe")
        self.knowledge = Knowledge(config, host.now_ns)
        self.loop = LoopCommands(host.forward, host.now_ns, self._heard)
        self.parameters = Parameters(
            base,
            GenerationStore(state / PARAMETERS),
            self.loop,
            lambda: self.modes.mode,
            self.down.send,
            self.report,
        )
        self.commands = CommandLog(state, self.boot.count, host.now_ns, host.epoch)
        self.dumps = Dumps(self.down.send)
        self.sets = Sets(self)
        self._wire_reports()
        self._wire_reactions(base)
        self._wire_storage(config, base, state)
        self.dispatcher = TcDispatcher(
            lambda: self.modes.mode, self.down.send, self.report_checked, self.commands
        )
        context = TelemetryContext(
            now_ns=host.now_ns,
            epoch=host.epoch,
            state=state,
            send=self.down.send,
            report=self.report,
            parameter=self.parameters.get,
            dispatcher=self.dispatcher,
        )
        self.onboard = OnBoardServices(
            context,
            self.filing.find,
            self.tables.content,
            telemetry.packet_stores,
            Outlet(send=self.down.again, room_bytes=self._room_bytes),
        )
        self.down.keep = self.onboard.playback.keep
        self.dispatcher.add(self._handlers())
        dispatcher = self.dispatcher
        self.loop.dispatcher = self.transfers.dispatcher = self.dumps.dispatcher = dispatcher

    def _wire_reports(self) -> None:
        get = self.parameters.get
        self.events = Eventing(
            self.down.send_at,
            self.down.send,
            lambda: (int(get("event_throttle_count")), get("event_throttle_period_s")),
            self.dumps,
            self.state,
            self.boot.count,
        )
        self.times = TimeReports(
            self.down, self.host.epoch, lambda: int(get("time_report_exponent"))
        )
        self.housekeeping = Housekeeping(
            self._telemetry, self.sets.builders(), self.down.send, self.down.wrap
        )

    def _wire_reactions(self, base: Config) -> None:
        self.functions = Functions(
            self.loop,
            self.modes,
            self.host.recording,
            lambda: base.unknown,
            partial(self.parameters.get, "batch_last_s"),
            self.knowledge.asked,
            self.down.send,
            self._mode_changed,
        )
        self.monitoring = Monitoring(
            self.sets.watched, self.host.now_ns, self.down.send, self.report, self.functions.act
        )
        self.supervision = Supervision(
            self.knowledge,
            self.modes,
            self.host.now_ns,
            base.service.status_rate_hz,
            partial(self.parameters.get, "command_loss_time_s"),
            self.report,
            self.functions.go_safe,
        )

    def _wire_storage(self, config: Config, base: Config, state: Path) -> None:
        files = state / self._telemetry.file_directory
        self.filing = filing_of(config, files, self.host.recording, self.down.send)
        self.transfers = Transfers(self.filing, self.host.now_ns, self.down.send, self.report)
        self.effects = TableEffects(
            base, state, self.loop, self.housekeeping, self.monitoring, self._configured
        )
        self.tables = Tables(
            state / TABLES,
            files / TABLES,
            self.effects.validate,
            self.effects.apply,
            self.effects.dump,
            self.filing.find,
            self.down.send,
            self.report,
        )
        self.monitoring.keep = lambda table: self.tables.replace(
            Table.MONITORS, to_yaml(table.model_dump(mode="json"))
        )
        self.effects.config, self.effects.active = config, self.tables.active
        for table in Table:
            if self.tables.active(table):
                self.effects.recall(table, self.tables.active(table))

    def deliver_by(self, delivery: FileDelivery) -> None:
        """Use this file delivery."""
        self.delivery = self.transfers.delivery = delivery

    def open(self) -> None:
        """Open the link; what cannot be opened is an event."""
        try:
            self.link = LinkServer(
                self._telemetry,
                self._uplink,
                self.report,
                seal=self.security.seal if self.security is not None else bytes,
                notice=self._notice,
            )
        except PortError as error:
            self.report("LINK_FAILED", str(error))
        else:
            self.down.out = self.link.send
        self.report("STARTED", self.boot.text())
        if self.boot.cause == CRASHED:
            self.supervision.health.set(Health.UNCLEAN_RESTART)

    def poll(self, now_ns: int) -> None:
        """Serve the link, timers and transfers; never waits."""
        if self.link is not None:
            self._serve_link(self.link, now_ns)
        self.dumps.poll()
        for code, text in self.summaries.poll(now_ns):
            self.host.report(SEVERITIES[code], code, text)
        self.loop.poll()
        self.onboard.poll(now_ns)
        self.supervision.poll(now_ns)
        self.monitoring.poll(now_ns)
        self.transfers.poll()
        if self.delivery is not None and (self.link is None or self.link.has_receiver):
            for pdu in self.delivery.poll(now_ns):
                self.down.file_unit(pdu)
        self.housekeeping.poll(now_ns)
        self.times.poll(now_ns)
        if self.security is not None:
            self.security.poll(now_ns)
        if self.link is not None:
            self.link.flush()

    def _room_bytes(self) -> int:
        return self.link.room_bytes if self.link is not None else NO_LINK_ROOM_BYTES

    def _serve_link(self, link: LinkServer, now_ns: int) -> None:
        """Carry out what came up, as much as one look of the service has time for."""
        link.serve(now_ns)
        for _ in range(MAX_ITEMS):
            item = link.next_item()
            if item is None:
                return
            self.take(item, now_ns)
            if self.host.now_ns() - now_ns > MAX_WORK_NS:
                return

    def close(self) -> None:
        """Close the link; write down that the end was in order."""
        if self.link is not None:
            self.link.close()
        for code, text in self.summaries.close():
            self.host.report(SEVERITIES[code], code, text)
        if self.security is not None:
            self.security.close()
        self.boot.keep(self._boot_store, running=False, commanded=self._restart)

    def summary(self) -> dict[str, Any]:
        """Return plain values for the status file."""
        return {
            "port": self.link.port if self.link is not None else None,
            "look_port": self.link.look_port if self.link is not None else None,
            "mode": self.modes.mode.name,
            "health": self.supervision.health.latched,
            "boot_count": self.boot.count,
            "tc": asdict(self.dispatcher.counters),
            "link": asdict(self.link.counters) if self.link is not None else {},
        }

    def status(self, status: Mapping[str, Any]) -> None:
        """Take the loop's summary."""
        self.knowledge.heard_status(status)
        self.supervision.heard_status()
        if self.modes.mode is Mode.SAFE and status.get("identifying", False):
            self.functions.go_safe()  # a restored state may have been identifying

    def estimate(self, estimate: Estimate) -> None:
        """Take an estimate."""
        self.knowledge.estimate = estimate

    def block(self, block: Block) -> None:
        """Take a window."""
        self.knowledge.heard_block(block)

    def science(self, t_ns: int, record: bytes) -> None:
        """Take the newest samples."""
        self.housekeeping.science(t_ns, record)

    def event(self, event: Event) -> None:
        """Take an event, whoever reported it."""
        self.events.take(event)
        self.supervision.event(event.code)
        self.onboard.event(event.code)

    def reply(self, reply: Reply) -> None:
        """Take the loop's answer to a command."""
        self._local_reply(reply)
        self.loop.reply(reply)

    def job(self, report: JobReport) -> None:
        """Take progress or end of a batch job."""
        self.knowledge.heard_job(report)
        self.modes.job(report.state == "running")
        self.supervision.mode_changed()
        self.loop.job(report)

    def report(self, code: str, text: str) -> None:
        """Report an event of our own, with the severity the dictionary has for it."""
        self.report_checked(code, text)

    def report_checked(self, code: str, text: str) -> bool:
        """Report an event; return whether it passed.

        Of a burst that the other side of the link causes, only the rate is reported.
        """
        passes = self.summaries.passes(code, text, self.host.now_ns())
        if passes:
            self.host.report(SEVERITIES[code], code, text)
        return passes

    def local_command(self, command: Command) -> None:
        """Note a command of the local control socket; its reply ends it."""
        arguments = " ".join(f"{name}={value}" for name, value in command.args.items())
        name = str(command.name).upper()
        self._local[command.id] = self.commands.begin("local socket", name, arguments)
        if len(self._local) > MAX_LOCAL:
            del self._local[next(iter(self._local))]

    def _local_reply(self, reply: Reply) -> None:
        record = self._local.pop(reply.id, None)
        if record is None:
            return
        if reply.accepted:
            self.commands.end(record, CommandOutcome.COMPLETED, Error.NONE)
            self.report("TC_COMPLETED", record.words)
        else:
            self.commands.end(record, CommandOutcome.FAILED, Error.FAILED)
            self.report("TC_FAILED", f"{record.name}: {reply.text} ({record.who})")

    def _uplink(self, may_command: bool) -> Uplink:
        if not may_command:
            return LookUplink()
        return ClearUplink() if self.security is None else SecureUplink(self.security.receiver)

    def _notice(self, reason: str) -> bytes:
        """Return the event packet that gives a refused client the reason."""
        values = {"event": IDS["LINK_REFUSED"], "occurrence": 1, "suppressed": 0, "text": reason}
        return self._refusals.make("event_low", self.host.now_ns(), values)

    def take(self, item: Uplinked, now_ns: int) -> None:
        """Pass one packet from the ground to where it belongs."""
        if item.error is not None:
            text = f"{item.text} ({item.source})".strip() if item.source else item.text
            self.dispatcher.refuse(item.packet, item.error, text, item.value)
        elif not item.is_file:
            if self.dispatcher.receive(item.packet, item.source):
                self.supervision.commanded()
        elif self.delivery is not None:
            self.delivery.receive(item.packet[HEADER_BYTES:], now_ns)

    def _mode_changed(self) -> None:
        self.supervision.mode_changed()

    def _heard(self, name: CommandName) -> None:
        """Take a command the loop has applied, whoever sent it."""
        if name in (CommandName.REST, CommandName.RESUME):
            self.modes.identifying(name is CommandName.RESUME)
        elif name is CommandName.RUN_BATCH:
            self.modes.job(True)
        elif name is CommandName.RESTART:
            self._restart = True
        self.supervision.mode_changed()

    def _configured(self, config: Config) -> None:
        self.knowledge.configured(config)
        self.host.configured(config)

    def _handlers(self) -> dict[str, Handler]:
        found: dict[str, Handler] = {}
        for part in (
            OwnCommands(self),
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
        ):
            found |= part.handlers()
        return found
