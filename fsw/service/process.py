"""The service process: recorder, status file, event log, control socket, batch worker.

The loop process starts `python -m fsw.service.process` with three inherited rings: from the loop,
from the estimation, and back to the loop. When the loop ends, also when it is killed, the service
records the messages left in the rings and closes the recording.
"""

import argparse
import os
import pickle
import signal
import sys
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from file_delivery.locks import keep_lock
from fsw.clock import Clock, MonotonicClock, boot_id, utc_correlation
from fsw.config import Config
from fsw.errors import MEMORY_EXIT, CommandError, ConfigError, PortError
from fsw.exchange.ring import RingReader, RingWriter
from fsw.exchange.ringlink import Kind, handed_down
from fsw.exchange.sinks import (
    Message,
    Record,
    ScienceRecord,
    StateRestored,
    StatusReport,
)
from fsw.messages import Block, Estimate, Event, Snapshot
from fsw.messages.commands import Code, Command, CommandName, Reply
from fsw.service.batch_jobs import BatchJobs
from fsw.service.block_log import BlockLog
from fsw.service.checkpoint_keeper import CheckpointKeeper
from fsw.service.console import Console
from fsw.service.control import SOCKET_NAME, ControlServer, refused
from fsw.service.disk_sync import DiskSync
from fsw.service.inbox import Inbox
from fsw.service.recorder import CHECKPOINT, event_values
from fsw.service.recorder_switch import RecorderSwitch
from fsw.service.start_check import check_start
from fsw.service.status_file import StatusFile
from fsw.service.turn import LOCK_NAME, take_turn
from fsw.telemetry.ports import Host
from fsw.telemetry.state.epoch import Epoch
from fsw.telemetry.state.journal import Journal

if TYPE_CHECKING:
    from fsw.telemetry.application import TelemetryApplication

EVENTS_NAME = "events.jsonl"
BLOCKS_NAME = "blocks.bin"
POLL_S = 0.01
LOG_LIMIT_BYTES = 8 << 20
NICE = 5
LOOK_NS = 1_000_000_000  # between looks at the state directory


class Service:
    """Receives all messages of loop and estimation; owns the files, sockets and batch jobs."""

    def __init__(
        self,
        config: Config,
        clock: Clock,
        down: RingReader,
        found: RingReader,
        up: RingWriter,
        *,
        resume: bool,
    ) -> None:
        """Create the state directory; recording and sockets are opened by `open`.

        Parameters
        ----------
        down, found, up : rings from the loop, from the estimation, and to the loop
        resume : continue the files of a crashed service of the same loop
        """
        self.turn: int | None = None  # descriptor that holds the lock of the directory
        self._config, self._clock, self._resume = config, clock, resume
        self.inbox, self._up = Inbox(down, found, self, self._report), up
        self._directory = config.resolve(config.service.state_directory)
        with suppress(OSError):  # `_look` tries again; the control socket reports the failure
            self._directory.mkdir(parents=True, exist_ok=True)
        self._status: Record = {}
        self._status_file = StatusFile(self._directory)
        self._event_counts = Counter(self._status_file.event_counts() if resume else {})
        reserve_bytes = config.service.disk_reserve_bytes
        self._events = Journal(self._directory / EVENTS_NAME, LOG_LIMIT_BYTES, reserve_bytes // 2)
        self._switch = RecorderSwitch(config, self._report)
        self._telemetry: TelemetryApplication | None = None
        self._keeper = CheckpointKeeper(config, self._directory, self._report)
        self._blocks = BlockLog(self._directory / BLOCKS_NAME, reserve_bytes, self._report)
        if resume:
            self._blocks.resume(self._keeper.block)
        self._control: ControlServer | None = None
        self._control_failed = False
        self._look_ns = 0  # time of the next look at the state directory
        self._jobs = BatchJobs(config, self._directory / BLOCKS_NAME, self._report)
        self._answers: list[Reply] = []  # to commands executed here
        self._console = Console()
        self._disk = DiskSync(self._files, partial(self._report, "high", "DISK_SYNC_FAILED"))

    def _files(self) -> list[Path]:
        """Return the paths of the growing files, for `DiskSync`."""
        files = [*self._events.files]
        if self._switch.path is not None:
            files.append(self._switch.path)
        if self._telemetry is not None:
            files += self._telemetry.files()
        return files

    def open(self) -> None:
        """Open recording, telemetry and control socket; report each failure as an event."""
        self._switch.open(resume=self._resume)
        if self._config.telemetry is not None:
            self._open_telemetry()
        self._open_control()

    def _open_control(self) -> None:
        """Open the control socket; report the first of successive failures."""
        try:
            self._control = ControlServer(
                self._directory / SOCKET_NAME, lambda: self._status, self._forward_local
            )
        except PortError as error:
            if not self._control_failed:
                self._report("high", "CONTROL_FAILED", str(error))
            self._control_failed = True
        else:
            self._control_failed = False

    def _look(self, now_ns: int) -> None:
        """Make the state directory and the control socket again if they were removed."""
        if now_ns < self._look_ns:
            return
        self._look_ns = now_ns + LOOK_NS
        if self._control is not None and self._control.is_removed:
            try:
                self._directory.mkdir(parents=True, exist_ok=True)
                if self.turn is not None:
                    self.turn = keep_lock(self._directory / LOCK_NAME, self.turn)
            except OSError:  # another daemon has taken it, which the loop reports
                return
            self._control.close()
            self._control = None
            self._report("high", "STATE_REMOVED", f"{self._directory} or what was in it")
            self._blocks.begin_again()
            if self._telemetry is not None:
                self._telemetry.state_removed()
        if self._control is None:
            with suppress(OSError):
                self._directory.mkdir(parents=True, exist_ok=True)
            self._open_control()

    def _open_telemetry(self) -> None:
        from fsw.telemetry.assembly import build_application  # only where it is configured

        host = Host(
            now_ns=self._clock.now_ns,
            epoch=partial(_epoch, boot_id()),
            forward=self._forward,
            report=self._report,
            configured=self._configured,
            recording=self._switch,
        )
        try:
            self._telemetry = build_application(self._config, host, resume=self._resume)
        except (ConfigError, OSError) as error:
            self._report("high", "LINK_FAILED", str(error))
        else:
            self._telemetry.open()

    def cycle(self) -> bool:
        """Read the rings, serve clients, poll the worker; return False when the loop has ended."""
        more = self.inbox.take()
        answers, self._answers = self._answers, []
        for answer in answers:
            self._reply(answer)
        for report in self._jobs.poll():
            if self._telemetry is not None:
                self._telemetry.job(report)
        if self._telemetry is not None:
            self._telemetry.poll(self._clock.now_ns())
        self._disk.poll(self._clock.now_ns())
        self._look(self._clock.now_ns())
        wait_s = 0.0 if more or not self.inbox.is_open else POLL_S
        if self._control is not None:
            self._control.serve(wait_s, self._clock.now_ns())
        else:
            self._clock.sleep_until_ns(self._clock.now_ns() + round(wait_s * 1e9))
        return self.inbox.is_open

    def close(self) -> None:
        """Stop the worker; close telemetry, recording and socket; write the last status."""
        self._jobs.close()
        if self._telemetry is not None:
            self._telemetry.close()
        self._switch.close(self.inbox.dropped)
        if self._control is not None:
            self._control.close()
        self._write_status(running=False)
        self._disk.close()

    def put(self, message: Message) -> None:
        """Record one message and act on it; traffic is only recorded."""
        if isinstance(message, StatusReport):
            message = replace(message, values={**message.values, "job": self._jobs.summary()})
        if self._switch.sink is not None:
            self._switch.sink.put(message)
        match message:
            case Event():
                self.event(message)
            case Block():
                self._block(message)
            case Snapshot():
                self._keeper.write(message)
            case StateRestored():
                self._restored(message.sequence)
            case StatusReport():
                self._publish_status(message.values)
            case Reply():
                self._reply(message)
            case Estimate():
                self._jobs.estimate = message
                if self._telemetry is not None:
                    self._telemetry.estimate(message)
            case ScienceRecord() if self._telemetry is not None:
                self._telemetry.science(message.t_ns, message.data)
            case _:
                return

    def _block(self, block: Block) -> None:
        """Store a block for batch jobs and for checkpoints."""
        self._keeper.block(block)
        if self._telemetry is not None:
            self._telemetry.block(block)
        self._blocks.append(block)

    def _restored(self, sequence: int) -> None:
        """Attach checkpoint `sequence`, from which this run continues, to the recording."""
        data = self._keeper.adopt(sequence)
        if data is not None and self._switch.sink is not None:
            self._switch.sink.attach(CHECKPOINT, data)

    def event(self, event: Event) -> None:
        """Count an event and pass it to telemetry, event log and console."""
        self._event_counts[event.code] += 1
        if self._telemetry is not None:
            self._telemetry.event(event)
        self._events.append(event_values(event))
        self._console.event(event)

    def _publish_status(self, status: Record) -> None:
        """Keep the newest status and publish it in telemetry and in the status file."""
        self._status = status
        if self._switch.sink is not None:
            self._switch.sink.dropped = self.inbox.dropped
            self._switch.sink.sync()
        if self._telemetry is not None:
            self._telemetry.status(status)
        self._write_status(running=True)

    def _reply(self, reply: Reply) -> None:
        """Pass a reply to telemetry and to the control socket, where the client may wait."""
        if self._telemetry is not None:
            self._telemetry.reply(reply)
        if self._control is not None:
            self._control.reply(reply)

    def _configured(self, config: Config) -> None:
        """Adopt the effective configuration for everything written from now on."""
        self._config = config
        self._switch.configured(config)
        self._keeper.configured(config)
        self._jobs.config = config

    def _write_status(self, *, running: bool) -> None:
        recorder: Mapping[str, Any] = {
            "path": None if self._switch.path is None else str(self._switch.path),
            "failing": self._switch.failing,
            "failed_messages": self._switch.lost,
            "dropped": self.inbox.dropped,
        }
        extra = {
            "running": running,
            "recorder": recorder,
            "checkpoint": self._keeper.summary(),
            "events": self._event_counts.total(),
            "events_not_logged": self._events.lost,
            "event_counts": dict(self._event_counts),
        }
        if self._telemetry is not None:
            extra["telemetry"] = self._telemetry.summary()
        self._status = {**self._status, **extra}
        self._status_file.write(self._status)

    def _forward_local(self, command: Command) -> bool:
        """Report and forward a command of the control socket; return False if the ring is full."""
        if self._telemetry is None:
            self._report("info", "TC_ACCEPTED", f"{command.name} (local socket)")
            return self._forward(command)
        self._telemetry.local_command(command)
        passed = self._forward(command)
        if not passed:
            self._telemetry.reply(refused(command))
        return passed

    def _forward(self, command: Command) -> bool:
        """Execute a batch command here, pass any other to the loop; return False: ring full."""
        name, number = str(command.name), command.id
        try:
            if command.name is CommandName.RESTART:
                check_start(self._config)
            passed = self._jobs.carry_out(command)
        except CommandError as error:
            code = Code(error.code)
            self._answers.append(
                Reply(id=number, command=name, accepted=False, code=code, text=str(error))
            )
            return True
        if passed is not None:
            return self._up.push(Kind.COMMAND, pickle.dumps(passed, protocol=5))
        self._answers.append(Reply(id=number, command=name, accepted=True, code=Code.ACCEPTED))
        return True

    def _report(self, severity: str, code: str, text: str) -> None:
        event = Event(self._clock.now_ns(), severity, code, text)
        self.event(event)
        if self._switch.sink is not None:
            self._switch.sink.put(event)


def _epoch(clock_id: str) -> Epoch:
    """Return the relation of the monotonic clock to UTC."""
    known = utc_correlation()
    return Epoch(
        clock_id=clock_id,
        utc_less_met_ns=known.utc_less_monotonic_ns,
        uncertainty_ns=known.uncertainty_ns,
        synchronised=known.synchronised,
    )


def serve(service: Service, parent: int, clock: Clock) -> int:
    """Serve one loop process until it ends; return the exit code."""
    while service.cycle():
        if os.getppid() != parent and service.inbox.is_idle:
            service.event(Event(clock.now_ns(), "high", "LOOP_LOST", "the loop process has died"))
            break
    service.close()
    return 0


def main(argv: list[str]) -> int:
    """Run the service process."""
    parser = argparse.ArgumentParser(prog="fsw.service.process", description=__doc__)
    parser.add_argument("--down", type=int, required=True, help="descriptor of the loop's ring")
    parser.add_argument("--found", type=int, required=True, help="of the estimation's ring")
    parser.add_argument("--up", type=int, required=True, help="descriptor of the ring to the loop")
    parser.add_argument("--config", type=int, required=True, help="descriptor of the configuration")
    parser.add_argument("--parent", type=int, required=True, help="process of the loop")
    parser.add_argument("--resume", action="store_true", help="take over from one that has died")
    arguments = parser.parse_args(argv)
    clock = MonotonicClock()
    began_ns = clock.now_ns()
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the loop's end is what ends the service
    os.nice(NICE)
    config = handed_down(arguments.config)
    rings = RingReader(arguments.down), RingReader(arguments.found), RingWriter(arguments.up)
    turn = None
    try:
        turn = take_turn(config.resolve(config.service.state_directory))
    except TimeoutError as error:
        sys.stderr.write(f"fsw: {error.filename}: {error.strerror}\n")
        return 1
    except OSError:
        pass  # the first write to this directory reports the error
    if arguments.resume and config.telemetry is not None:
        from fsw.telemetry.tables.effective import effective_config

        config = effective_config(config.as_read())  # tables may have been changed since the start
    service = Service(config, clock, *rings, resume=arguments.resume)
    service.turn = turn
    service.open()
    if arguments.resume:
        service.event(Event(began_ns, "info", "SERVICE_BACK", f"process {os.getpid()}"))
    try:
        return serve(service, arguments.parent, clock)
    except MemoryError:
        return MEMORY_EXIT


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
