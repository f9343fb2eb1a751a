"""A telemetry application on a fake host: no loop, no sockets, time by hand."""

from collections.abc import Mapping
from pathlib import Path

from fsw.config import Config
from fsw.errors import CommandError
from fsw.messages import Event
from fsw.messages.commands import Code, Command, CommandName, Reply
from fsw.telemetry.assembly import build_application
from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.outbox import Priority
from fsw.telemetry.link.packets import ACK_ALL, Decoder, Telemetry, telecommand_packet
from fsw.telemetry.ports import Host
from fsw.telemetry.state.epoch import Epoch
from tests.conftest import ArmProject
from tests.support.loop_cases import arm_config

SECOND = 10**9
EPOCH = Epoch(clock_id="first", utc_less_met_ns=1_700_000_000 * SECOND)


class FakeRecording:
    """Remembers what it was told."""

    def __init__(self) -> None:
        self.on = False
        self.path: Path | None = None

    def values(self) -> Mapping[str, object]:
        words = {"failed_messages": 0, "dropped_messages": 0, "recordings": 1}
        return {"recording": self.on, **words}

    def start(self) -> None:
        if self.on:
            raise CommandError("BUSY", "recording")
        self.on = True

    def stop(self) -> None:
        if not self.on:
            raise CommandError("NOT_STAGED", "not recording")
        self.on = False


class Flight:
    """The application, what it sent, and what it told the loop."""

    def __init__(
        self,
        config: Config,
        *,
        resume: bool = False,
        now: int = 1000 * SECOND,
        epoch: Epoch = EPOCH,
    ) -> None:
        self.now = now
        self.config = config
        self.packets: list[Telemetry] = []
        self.commands: list[Command] = []
        self.events: list[Event] = []
        self.in_force: list[Config] = []
        self.recording = FakeRecording()
        self.ring_full = False
        self.raw: list[bytes] = []
        self.priorities: list[Priority] = []
        self._decoder = Decoder()
        self._sequence = 0
        host = Host(
            now_ns=lambda: self.now,
            epoch=lambda: epoch,
            forward=self._forward,
            report=self._report,
            configured=self.in_force.append,
            recording=self.recording,
        )
        self._early: list[Event] = []
        self.app = None
        self.app = build_application(config, host, resume=resume)
        self.app.context.down.out = self._keep
        for event in self._early:
            self.app.event(event)

    def _forward(self, command: Command) -> bool:
        if not self.ring_full:
            self.commands.append(command)
        return not self.ring_full

    def _report(self, severity: str, code: str, text: str) -> None:
        event = Event(self.now, severity, code, text)
        self.events.append(event)
        if self.app is None:
            self._early.append(event)
        else:
            self.app.event(event)

    def _keep(self, packet: bytes, priority: Priority) -> None:
        self.priorities.append(priority)
        self.raw.append(packet)
        if packet[1] != 101:
            self.packets.append(self._decoder.decode(packet))

    def up(self, *, identifying: bool = True, **more) -> None:
        """The loop says that it is there."""
        self.app.status({"identifying": identifying, "job": None, **more})

    def send(self, name: str, values: dict | None = None, *, ack: int = ACK_ALL) -> list[str]:
        """Give a telecommand; return the names of what came back."""
        before = len(self.packets)
        packet = telecommand_packet(
            DICTIONARY.telecommand(name), values or {}, self._sequence, ack=ack
        )
        self._sequence += 1
        self.app.executor.receive(packet)
        return [p.packet.name for p in self.packets[before:]]

    def answer(self, code: Code = Code.ACCEPTED, text: str = "", **data) -> None:
        """The loop answers the oldest command that waits."""
        command = self.commands.pop(0)
        self.app.reply(
            Reply(
                id=command.id,
                command=str(command.name),
                accepted=code is Code.ACCEPTED,
                code=code,
                text=text,
                data=data,
            )
        )

    def last(self, name: str) -> dict:
        """The values of the newest packet of a name."""
        return next(p.values for p in reversed(self.packets) if p.packet.name == name)

    def all(self, name: str) -> list[dict]:
        """The values of every packet of a name."""
        return [p.values for p in self.packets if p.packet.name == name]

    @property
    def codes(self) -> list[str]:
        return [event.code for event in self.events]

    def error(self) -> Error:
        """The error of the newest failure."""
        names = ("acceptance_failure", "completion_failure", "routing_failure")
        told = [p for p in self.packets if p.packet.name in names]
        return Error(told[-1].values["error"])

    def refused(self, name: str, values: dict | None = None) -> Error:
        """Give a telecommand that must be rejected without effect; return why."""
        waiting = len(self.commands)
        told = self.send(name, values)
        assert "acceptance_failure" in told
        assert "acceptance_success" not in told
        assert len(self.commands) == waiting
        return self.error()

    def wait(self, seconds: float) -> None:
        """Let time go by in tenths, as the service looks."""
        for _ in range(max(1, round(10 * seconds))):
            self.now += SECOND // 10
            self.app.poll(self.now)


def flight_config(arm: ArmProject, **telemetry) -> Config:
    """A daemon with telemetry that listens where nobody else does."""
    arm.data["telemetry"] = {"port": 0, "housekeeping_interval_s": 0.0, **telemetry}
    return arm_config(arm)


DONE = ["acceptance_success", "start_success", "completion_success"]
BEGUN = DONE[:2]
APPLIED = CommandName
