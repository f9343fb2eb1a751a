"""A whole daemon in one process and in virtual time: loop, service and control socket.

Telecommands pass the uplink, the executor and the command queue. The loop runs with a simulated
plant, and the store gets the blocks. Every telecommand and every line must be answered.
"""

import os
import re
import socket
import tempfile
from collections import Counter, deque
from pathlib import Path
from typing import Any

from evidence.fuzz.choices import Choices
from evidence.fuzz.damage import damaged_packet, repaired_packet
from evidence.fuzz.hostile import Grammar, named_telecommand
from evidence.fuzz.oracle import require
from fsw.config import Config
from fsw.errors import CommandError
from fsw.exchange.sinks import Message, ScienceRecord, StatusReport
from fsw.loop.ports import Ports
from fsw.messages import Block, Estimate, Event
from fsw.messages.commands import JOBS, Code, Command, CommandName, Reply
from fsw.service.blockstore import BlockWriter
from fsw.service.control import ControlServer
from fsw.telemetry.assembly import build_application
from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.link.packets import TM_HEADER_BYTES
from fsw.telemetry.link.uplink import ClearUplink
from fsw.telemetry.ports import Host
from fsw.telemetry.state.epoch import Epoch
from hil.devices.plant import Plant
from hil.links.virtual import VirtualBench
from hil.run.bench import T0_NS, prepare
from hil.run.daemon import Daemon
from hil.world.scenario import load
from hil.world.sensor_config import SensorConfig

WINDOW_S = 0.1
LOOK_NS = 100_000_000
MOST_LOOKS = 80  # most calls of `look` until a telecommand is completed
UNFORESEEN = re.compile(r"\b(?!(?:Tc|Config|Command|Estimator|Text|Port|OS)Error)\w*Error: ")
LONG = {"RUN_BATCH", "RUN_PLAN", "DOWNLINK_FILE", "DOWNLINK_PIECE", "PLAY_BACK", "CHECK_OBJECT"}
OUTSIDE = b"nothing of this may change"
REQUEST_AT = TM_HEADER_BYTES  # place of the request's identity in a verification report
SEQUENCE_AT = REQUEST_AT + 2
VERIFICATION = {p.subtype: p.name for p in DICTIONARY.packets if p.service == 1}
BATCH = (*JOBS, CommandName.ABORT_BATCH, CommandName.ADOPT)


class _Recording:
    """A stand-in for the recorder, which starts and stops and records nothing."""

    path: Path | None = None
    _on = False

    def values(self) -> dict[str, Any]:
        """Return the state and the counters as the recorder reports them."""
        words = dict.fromkeys(("failed_messages", "dropped_messages", "recordings"), 0)
        return {"recording": self._on, **words}

    def start(self) -> None:
        """Start recording. Raises CommandError if the recording is already on."""
        if self._on:
            raise CommandError("BUSY", "recording")
        self._on = True

    def stop(self) -> None:
        """Stop recording. Raises CommandError if the recording is off."""
        if not self._on:
            raise CommandError("NOT_STAGED", "not recording")
        self._on = False


class OperationsBench:
    """Loop and service in virtual time; counts their events and keeps their reports."""

    def __init__(self, folder: Path) -> None:
        telemetry = {"port": 0, "housekeeping_interval_s": 0.0, "start_mode": "standby"}
        setup = prepare(
            load("target_leo"), 1, folder, overrides={"window_s": WINDOW_S}, telemetry=telemetry
        )
        config = setup.config
        rate_hz = float(setup.scenario.flight["bus"]["rate_hz"])
        sensors = SensorConfig.from_dict(setup.scenario.sensors)
        plant = Plant(
            setup.history, sensors, 1, start_delay_s=1.0, t0_ns=T0_NS, sync_rate_hz=rate_hz
        )
        self._world = VirtualBench(plant, T0_NS, seed=1)
        self._later_ns = 0  # time of the service less time of the loop
        self.counts: Counter[str] = Counter()
        self.events: deque[Event] = deque(maxlen=1000)
        self.reports: dict[tuple[int, int], list[str]] = {}
        self._sequence = 0
        self.state = config.resolve(config.service.state_directory)
        self.state.mkdir(parents=True, exist_ok=True)
        self._blocks = BlockWriter(self.state / "blocks.bin", 64)
        self._app_open = False
        self._early: list[Event] = []
        self._commands: deque[Command] = deque()
        self._refused: deque[Command] = deque()  # batch commands; the bench has no worker process
        self._open_service(config)
        world = self._world
        names = [bus.name for bus in config.buses]
        ports = Ports(
            can=dict.fromkeys(names, world.can), imu=world.imu, star_tracker=world.star_tracker
        )
        self.daemon = Daemon(config, world.clock, ports, self)
        robot = config.resolve(config.robot.urdf).read_text(encoding="utf-8")
        self.grammar = Grammar(tuple(joint.name for joint in config.joints), robot)

    def _open_service(self, config: Config) -> None:
        host = Host(
            now_ns=self.now_ns,
            epoch=lambda: Epoch(clock_id="fuzz", utc_less_met_ns=0),
            forward=self._forward,
            report=self._report,
            configured=lambda _: None,
            recording=_Recording(),
        )
        self.app = build_application(config, host, resume=False)
        self.app.context.down.out = self._sent
        self._app_open = True
        for event in self._early:
            self.app.event(event)
        self.app.status({"identifying": False, "job": None})
        self._uplink = ClearUplink()
        path = Path(tempfile.mkdtemp(prefix="fuzz-")) / "ctl.sock"
        self._control = ControlServer(path, dict, self._forward)
        self._client = socket.socket(socket.AF_UNIX)
        self._client.connect(os.fspath(path))
        self._client.setblocking(False)
        self._control.serve(0.0, self.now_ns())
        self.files = self.state / "files"
        self.files.mkdir(exist_ok=True)
        self.outside = self.state.parent / "outside"
        self.outside.write_bytes(OUTSIDE)

    def close(self) -> None:
        """Close sockets and service."""
        self._client.close()
        self._control.close()
        self.app.close()

    def now_ns(self) -> int:
        """Return the time of the service [ns]."""
        return self._world.clock.now_ns() + self._later_ns

    def put(self, message: Message) -> None:
        """Accept a message of the loop as the service does."""
        match message:
            case Event():
                self._event(message)
            case Block():
                self._blocks.append(message)
                self.app.block(message)
                self.counts["blocks"] += 1
            case StatusReport():
                self.app.status(message.values)
            case Reply():
                self.app.reply(message)
                self._control.reply(message)
            case Estimate():
                self.app.estimate(message)
            case ScienceRecord():
                self.app.science(message.t_ns, message.data)
            case _:
                return

    def _report(self, severity: str, code: str, text: str) -> None:
        self._event(Event(self.now_ns(), severity, code, text))

    def _event(self, event: Event) -> None:
        self.events.append(event)
        self.counts[event.code] += 1
        if self._app_open:
            self.app.event(event)
        else:
            self._early.append(event)
        require(event.code != "COMMAND_FAILED", "an error nobody foresaw", event)
        require(not UNFORESEEN.search(event.text), "an error nobody foresaw", event)
        require(event.code != "BLOCKS_FAILED", "a stored shape has changed", event)

    def _forward(self, command: Command) -> bool:
        self.counts["forwarded"] += 1
        if command.name in BATCH:
            self._refused.append(command)
        else:
            self._commands.append(command)
        return True

    def _sent(self, packet: bytes, _priority: object = None) -> None:
        if len(packet) < 9 or packet[7] != 1 or packet[1] != 100:
            return
        identity = int.from_bytes(packet[REQUEST_AT:SEQUENCE_AT], "big")
        sequence = int.from_bytes(packet[SEQUENCE_AT : SEQUENCE_AT + 2], "big")
        request = (identity, sequence)
        if request in self.reports:
            self.reports[request].append(VERIFICATION[packet[8]])

    def tick(self, count: int = 1) -> None:
        """Give the waiting commands to the loop and run `count` ticks."""
        while self._commands:
            self.daemon.submit(self._commands.popleft())
        for _ in range(count):
            self.daemon.step()
        self.daemon.loop.stop_requested = False  # ignore a RESTART that was accepted

    def look(self, later_ns: int = LOOK_NS) -> None:
        """Run one cycle of the service `later_ns` later, and a tick if commands wait."""
        self._later_ns += later_ns
        if self._commands:
            self.tick()
        while self._refused:
            command = self._refused.popleft()
            name, text = str(command.name), "no worker here"
            code = Code.NOT_SUPPORTED
            self.put(Reply(id=command.id, command=name, accepted=False, code=code, text=text))
        self.app.poll(self.now_ns())
        self._control.serve(0.0, self.now_ns())

    def give(self, packet: bytes, name: str) -> None:
        """Send one telecommand and wait for its completion. Raises OracleError."""
        request = (int.from_bytes(packet[:2], "big"), int.from_bytes(packet[2:4], "big"))
        self.reports = {request: []}
        told = self.reports[request]
        for item in self._uplink.feed(packet, self.now_ns()):
            self.app.receive(item, self.now_ns())
        self.counts["telecommands"] += 1
        begun = [word for word in told if word.startswith(("acceptance", "routing"))]
        require(len(begun) == 1, "not answered once", name, packet.hex(), told)
        if begun[0] != "acceptance_success":
            return
        self.counts["accepted"] += 1
        for _ in range(MOST_LOOKS):
            if any(word.startswith("completion") for word in told) or name in LONG:
                return
            self.look()
        require(False, "accepted and never ended", name, packet.hex(), told)

    def command(self, name: str, **values: object) -> None:
        """Send a telecommand by name and wait for its completion."""
        self.give(named_telecommand(name, values, self.sequence()), name)

    def sequence(self) -> int:
        """Return the next sequence count for a telecommand."""
        self._sequence = (self._sequence + 1) & 0x1FFF
        return self._sequence

    def damaged(self, packet: bytes, choices: Choices) -> None:
        """Send a damaged telecommand and then a valid one; check both."""
        damaged_packet(self, packet, choices)

    def repaired(self, packet: bytes, choices: Choices) -> None:
        """Send a changed telecommand with a correct check value; check the effect."""
        repaired_packet(self, packet, choices)

    def line(self, data: bytes) -> None:
        """Send one line to the control socket and wait for the answer. Raises OracleError."""
        self._client.sendall(data + b"\n")
        answer = b""
        for _ in range(MOST_LOOKS):
            self.look()
            try:
                answer += self._client.recv(1 << 20)
            except BlockingIOError:
                continue
            if answer.endswith(b"\n"):
                break
        require(answer.count(b"\n") == 1, "a line without one answer", data[:200], answer[:200])
        self.counts["lines"] += 1
