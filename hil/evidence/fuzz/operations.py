"""Target of a whole daemon: an input is a sequence of hostile commands, tables, files and lines.

Loop and service are the real ones, in one process and in virtual time: telecommands go through the
uplink, the executor and the command queue; the loop ticks over a simulated plant; blocks go to the
store. What must hold: nothing raises; every telecommand is answered, with its completion where it
was accepted; every line of the control socket has one answer; no error is one that nobody foresaw;
what is reported stays short; nothing that waits grows.
"""

from __future__ import annotations

import atexit
import os
import re
import socket
import tempfile
import zlib
from collections import Counter, deque
from functools import partial
from pathlib import Path
from typing import Any

from fsw.config import Config
from fsw.exchange.sinks import Message, ScienceRecord, StatusReport
from fsw.loop.ports import Ports
from fsw.loop.wiring import build
from fsw.messages import Block, Estimate, Event
from fsw.messages.commands import Code, Command, CommandName, Reply
from fsw.messages.errors import CommandError
from fsw.service.blockstore import BlockWriter
from fsw.service.control import ControlServer
from fsw.telemetry.assembly import build_application
from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.link.packets import Decoder, telecommand_packet
from fsw.telemetry.link.uplink import ClearUplink
from fsw.telemetry.ports import Host
from fsw.telemetry.state.epoch import Epoch
from hil.devices.plant import Plant
from hil.evidence.fuzz.choices import Choices
from hil.evidence.fuzz.hostile import Grammar
from hil.evidence.fuzz.oracle import Target, require
from hil.links.virtual import VirtualBench
from hil.run.bench import T0_NS, prepare
from hil.world.scenario import load
from hil.world.sensors import SensorConfig

MOST_STEPS = 24  # of one sequence
WINDOW_TICKS = 260  # the plant's samples of a window and a half, as the loop takes them
LOOK_NS = 100_000_000
MOST_LOOKS = 80  # until a telecommand that the loop carries out has its end
UNFORESEEN = re.compile(r"\b(?!(?:Tc|Config|Command|Estimator|Text|Port|OS)Error)\w*Error: ")
LONG = {"RUN_BATCH", "DOWNLINK_FILE", "DOWNLINK_PIECE", "PLAY_BACK", "CHECK_OBJECT"}  # a peer ends
PIECE_BYTES = 900
BATCH = (CommandName.RUN_BATCH, CommandName.ABORT_BATCH, CommandName.ADOPT)
OUTSIDE = b"nothing of this may change"
TABLES = ("ROBOT", "NOISE", "RATES", "MONITORS")


class _Recording:
    """A recorder that starts and stops."""

    path: Path | None = None
    _on = False

    def values(self) -> dict[str, Any]:
        """Return its counters."""
        words = dict.fromkeys(("failed_messages", "dropped_messages", "recordings"), 0)
        return {"recording": self._on, **words}

    def start(self) -> None:
        """Begin. Raises CommandError."""
        if self._on:
            raise CommandError("BUSY", "recording")
        self._on = True

    def stop(self) -> None:
        """End. Raises CommandError."""
        if not self._on:
            raise CommandError("NOT_STAGED", "not recording")
        self._on = False


class OperationsBench:
    """Loop, service and what comes out of them."""

    def __init__(self, folder: Path) -> None:
        telemetry = {"port": 0, "housekeeping_interval_s": 0.0, "start_mode": "standby"}
        setup = prepare(load("target_leo"), 1, folder, telemetry=telemetry)
        config = setup.config
        rate_hz = float(setup.scenario.flight["bus"]["rate_hz"])
        sensors = SensorConfig.from_dict(setup.scenario.sensors)
        plant = Plant(
            setup.history, sensors, 1, start_delay_s=0.0, t0_ns=T0_NS, sync_rate_hz=rate_hz
        )
        self._world = VirtualBench(plant, T0_NS, seed=1)
        self._later_ns = 0  # of the service's clock, ahead of the loop's
        self.counts: Counter[str] = Counter()
        self.events: deque[Event] = deque(maxlen=1000)
        self.reports: dict[tuple[int, int], list[str]] = {}
        self._decoder, self._sequence = Decoder(), 0
        self.state = config.resolve(config.service.state_directory)
        self.state.mkdir(parents=True, exist_ok=True)
        self._blocks = BlockWriter(self.state / "blocks.bin", 64)
        self._app_open = False
        self._early: list[Event] = []
        self._commands: deque[Command] = deque()
        self._refused: deque[Command] = deque()  # batch jobs: their worker is a process
        self._open_service(config)
        world = self._world
        names = [bus.name for bus in config.buses]
        ports = Ports(
            can=dict.fromkeys(names, world.can), imu=world.imu, star_tracker=world.star_tracker
        )
        self.daemon = build(config, world.clock, ports, self)
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
        """Close what is open."""
        self._client.close()
        self._control.close()
        self.app.close()

    def now_ns(self) -> int:
        """Return the service's time."""
        return self._world.clock.now_ns() + self._later_ns

    def put(self, message: Message) -> None:
        """Process a message of the loop as the service does."""
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
        if command.name in BATCH:
            self._refused.append(command)
        else:
            self._commands.append(command)
        return True

    def _sent(self, packet: bytes, _priority: object = None) -> None:
        if len(packet) < 9 or packet[7] != 1 or packet[1] != 100:
            return
        told = self._decoder.decode(packet)
        request = (int(told.values["request_packet_id"]), int(told.values["request_sequence"]))
        if request in self.reports:
            self.reports[request].append(told.packet.name)

    def tick(self, count: int = 1) -> None:
        """Let the loop tick."""
        while self._commands:
            self.daemon.submit(self._commands.popleft())
        for _ in range(count):
            self.daemon.step()
        self.daemon.dispatcher.stop_requested = False  # a RESTART that was accepted

    def look(self, later_ns: int = LOOK_NS) -> None:
        """Let the service look at everything once, some time later."""
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
        """Give one telecommand and wait for its end."""
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
        """Give a telecommand by name."""
        item = DICTIONARY.telecommand(name)
        words = {f.name: f.enumeration.value(str(values[f.name])) if f.enumeration is not None
                 and isinstance(values.get(f.name), str) else values.get(f.name)
                 for f in item.arguments}  # fmt: skip
        self.give(telecommand_packet(item, words, self.sequence()), name)

    def sequence(self) -> int:
        """Return the next sequence count."""
        self._sequence = (self._sequence + 1) & 0x1FFF
        return self._sequence

    def line(self, data: bytes) -> None:
        """Give one line of the control socket and wait for its answer."""
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


def operations_target() -> Target:
    """Return the target of a whole daemon in virtual time; it is open until the process ends."""
    bench = OperationsBench(Path(tempfile.mkdtemp(prefix="fuzz-operations-")))
    atexit.register(bench.close)
    return partial(play, bench)


def play(bench: OperationsBench, data: bytes) -> None:
    """Play one input as a sequence of hostile steps. Raises OracleError."""
    choices = Choices(data)
    for _ in range(MOST_STEPS):
        if not choices.more:
            break
        _step(bench, choices)
    bench.look()
    require(bench.outside.read_bytes() == OUTSIDE, "a file outside was written", bench.outside)


def _step(bench: OperationsBench, choices: Choices) -> None:
    kind = choices.number(40)
    bench.counts["cases"] += 1
    if kind == 0:
        _upload(bench, choices)
    elif kind == 1:
        bench.line(bench.grammar.line(choices))
    elif kind == 2:
        _file(bench, choices)
    elif kind == 3:
        bench.look(choices.one((LOOK_NS, 1, 10**9, 6 * 10**9, 120 * 10**9)))
    elif kind == 4:
        bench.command("SET_MODE", mode=choices.one(("STANDBY", "IDENTIFY", "SAFE")))
    else:
        packet = bench.grammar.telecommand(choices, bench.sequence())
        bench.give(packet, _name(packet))


def _name(packet: bytes) -> str:
    service, subtype = packet[7], packet[8]
    function = int.from_bytes(packet[11:13], "big") if service == 8 else None
    key = (service, subtype, function)
    found = [
        t.name for t in DICTIONARY.telecommands if (t.service, t.subtype, t.function_id) == key
    ]
    return found[0] if found else ""


def _upload(bench: OperationsBench, choices: Choices) -> None:
    """Load a table, validate, and mostly activate it; then let the loop take a window with it."""
    number = choices.number(4)
    table, content = TABLES[number], bench.grammar.table(number, choices)
    crc32 = zlib.crc32(content)
    if choices.once_in(3):
        place = bench.files / "upload"
        place.write_bytes(content)
        bench.command("TBL_LOAD_FILE", table=table, crc32=crc32, path="files/upload")
    else:
        bench.command("TBL_LOAD", table=table, size_bytes=max(1, len(content)), crc32=crc32)
        for start in range(0, len(content), PIECE_BYTES):
            piece = content[start : start + PIECE_BYTES]
            bench.command("TBL_DATA", table=table, offset=start, data=piece)
    bench.command("TBL_VALIDATE", table=table)
    bench.command("SET_MODE", mode="STANDBY")
    before = bench.counts["TABLE_ACTIVATED"]
    bench.command("TBL_ACTIVATE", table=table, crc32=crc32)
    bench.counts["uploads"] += 1
    if bench.counts["TABLE_ACTIVATED"] > before and number < 2:
        bench.command("SET_MODE", mode="IDENTIFY")
        bench.tick(WINDOW_TICKS)
    if choices.once_in(2):
        bench.command("SET_MODE", mode="STANDBY")
        bench.command("TBL_ROLLBACK", table=table)


def _file(bench: OperationsBench, choices: Choices) -> None:
    """Put something strange into the file area."""
    path = bench.files / choices.one(("a.txt", "loop", "deep", "table", "empty"))
    kind = choices.number(5)
    if path.is_symlink() or path.is_file():
        path.unlink()
    elif path.is_dir():
        return
    if kind == 0:
        path.write_bytes(choices.raw(200))
    elif kind == 1:
        path.symlink_to(bench.files / "loop")
    elif kind == 2:
        path.symlink_to(bench.outside)
    elif kind == 3:
        path.mkdir()
        (path / "er").write_bytes(b"x")
