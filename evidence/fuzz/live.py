"""The hostile grammar against real processes: plant, loop and service, over TCP and socket.

A quiet stretch without commands comes before and after the attack. These must hold besides the
requirements of `operations.py`: no process of the daemon has ended. Compared with the worse quiet
stretch, the loop's own work exceeds a tick in at most MOST_MORE_OWN more of a thousand ticks, and
the loop misses at most MOST_MORE_SLIPS more. After the first tenth of the cases, the memory of each
process grows by at most MOST_GROWTH_MB.
"""

from __future__ import annotations

import random
import re
import socket
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from evidence.fuzz.choices import Choices
from evidence.fuzz.daemon_bench import LONG, OUTSIDE, UNFORESEEN, VERIFICATION
from evidence.fuzz.damage import damage, repair
from evidence.fuzz.hostile import Grammar, named_telecommand
from evidence.fuzz.operations import play
from evidence.fuzz.oracle import require
from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.link.packets import TM_HEADER_BYTES, telecommand_packet
from hil.run.bench import prepare
from hil.run.flight import write_yaml
from hil.run.live import LiveError, process_of, processes_of, read_status, started_plant
from hil.run.plant_document import plant_document
from hil.run.processes import resident_bytes
from hil.world.scenario import at_rates, load

RATE_HZ, IMU_RATE_HZ = 100.0, 125
QUIET_S = 20.0
STRETCHES = ("before", "attacked", "after")
MOST_MORE_SLIPS = 5.0  # in a thousand ticks; the machine causes such slips
MOST_MORE_OWN = 0.5  # in a thousand ticks; ticks whose own work exceeds the period
MOST_GROWTH_MB = 64.0  # of each process
ANSWER_S, START_S, LINE_S = 30.0, 60.0, 20.0
LOOK_S = 0.05  # longest real time of `look`
INPUT_BYTES = 120
HEADER_BYTES = 6
RESTART = re.compile(rb"\x08\x01..\x00\x05", re.DOTALL)  # PUS 8,1 with function 5
WITHOUT = frozenset({"RESTART"})  # a valid RESTART ends the loop
Request = tuple[int, int]


class LiveTarget:
    """The daemon as processes, with the interface that `play` uses (`operations.Attacked`)."""

    def __init__(self, grammar: Grammar, state: Path, port: int) -> None:
        self.grammar, self.counts = grammar, Counter[str]()
        self.files, self.outside = state / "files", state.parent / "outside"
        self.outside.write_bytes(OUTSIDE)
        self._state, self._sequence = state, 0
        self._link = socket.create_connection(("127.0.0.1", port), START_S)
        self._pending = bytearray()
        self._found: dict[Request, list[str]] = {}

    def close(self) -> None:
        """Close the link."""
        self._link.close()

    def sequence(self) -> int:
        """Return the next sequence count for a telecommand."""
        self._sequence = (self._sequence + 1) & 0x1FFF
        return self._sequence

    def look(self, later_ns: int = 0) -> None:
        """Read telemetry for `later_ns` of real time [ns], at most LOOK_S."""
        self._read(min(later_ns * 1e-9, LOOK_S))

    def tick(self, count: int = 1) -> None:
        """Read telemetry for the duration of `count` ticks."""
        self._read(count / RATE_HZ)

    def give(self, packet: bytes, name: str) -> None:
        """Send one telecommand and wait for its completion. Raises OracleError."""
        begun = self._exchange(packet, packet, bool)
        require(begun[0].startswith(("acceptance", "routing")), "not answered", packet.hex(), begun)
        self.counts["telecommands"] += 1
        if begun[0] != "acceptance_success":
            return
        self.counts["accepted"] += 1
        if name not in LONG:
            request = _request(packet)
            self._until(request, lambda words: any(w.startswith("completion") for w in words))

    def command(self, name: str, **values: object) -> None:
        """Send a telecommand by name and wait for its completion."""
        self.give(named_telecommand(name, values, self.sequence()), name)

    def damaged(self, packet: bytes, choices: Choices) -> None:
        """Send a damaged telecommand and then a PING, which the daemon must answer."""
        self._changed(damage(packet, choices), "damaged")

    def repaired(self, packet: bytes, choices: Choices) -> None:
        """Send a changed telecommand with a correct check value, and then a PING."""
        self._changed(repair(packet, choices), "repaired")

    def _changed(self, changed: bytes, kind: str) -> None:
        if RESTART.search(changed):
            return
        ping = telecommand_packet(DICTIONARY.telecommand("PING"), {}, self.sequence())
        self._exchange(changed + ping, ping, lambda words: "completion_success" in words)
        self.counts[kind] += 1

    def line(self, data: bytes) -> None:
        """Send one line to the control socket and wait for the answer. Raises OracleError."""
        answer = b""
        with socket.socket(socket.AF_UNIX) as client:
            client.settimeout(LINE_S)
            client.connect(str(self._state / "ctl.sock"))
            client.sendall(data + b"\n")
            while not answer.endswith(b"\n") and (piece := client.recv(1 << 16)):
                answer += piece
        require(answer.count(b"\n") == 1, "a line without one answer", data[:200], answer[:200])
        self.counts["lines"] += 1

    def _exchange(
        self, data: bytes, packet: bytes, ended: Callable[[list[str]], bool]
    ) -> list[str]:
        self._found = {_request(packet): []}
        self._link.sendall(data)
        return self._until(_request(packet), ended)

    def _until(self, request: Request, ended: Callable[[list[str]], bool]) -> list[str]:
        """Read until `ended` accepts the reports on a request; return them. Raises OracleError."""
        until_s = time.monotonic() + ANSWER_S
        words = self._found[request]
        while not ended(words):
            require(time.monotonic() < until_s, "not answered", request, words)
            self._read(0.01, once=True)
        return words

    def _read(self, wait_s: float, *, once: bool = False) -> None:
        """Read telemetry for `wait_s` [s]; `once`: only until the first bytes."""
        until_s = time.monotonic() + wait_s
        while (left_s := until_s - time.monotonic()) > 0.0:
            self._link.settimeout(left_s)
            try:
                data = self._link.recv(1 << 18)
            except TimeoutError:
                return
            require(data, "the daemon has closed the link")
            self._pending += data
            self._cut()
            if once:
                return

    def _cut(self) -> None:
        while len(self._pending) >= HEADER_BYTES:
            length = int.from_bytes(self._pending[4:6], "big") + HEADER_BYTES + 1
            if len(self._pending) < length:
                return
            packet = bytes(self._pending[:length])
            del self._pending[:length]
            self._packet(packet)

    def _packet(self, packet: bytes) -> None:
        if packet[1] != 100 or len(packet) < TM_HEADER_BYTES + 4:
            return
        if packet[7] == 5:
            text = packet[TM_HEADER_BYTES:].decode("ascii", "replace")
            require(not UNFORESEEN.search(text), "an error nobody foresaw", text)
        if packet[7] == 1:
            at = TM_HEADER_BYTES
            request = _words(packet[at : at + 4])
            if request in self._found:
                self._found[request].append(VERIFICATION[packet[8]])


def _words(data: bytes) -> Request:
    return int.from_bytes(data[:2], "big"), int.from_bytes(data[2:4], "big")


def _request(packet: bytes) -> Request:
    return _words(packet[:4])


@dataclass(frozen=True, slots=True)
class Mark:
    """Counts of ticks, slips, and ticks whose own work exceeded the period, at one time."""

    ticks: int
    slips: int
    over_budget: int

    def since(self, before: Mark) -> float:
        """Return the slips in a thousand ticks since an earlier mark."""
        return 1e3 * (self.slips - before.slips) / max(1, self.ticks - before.ticks)

    def own_since(self, before: Mark) -> float:
        """Return how many of a thousand ticks exceeded their budget since an earlier mark."""
        return 1e3 * (self.over_budget - before.over_budget) / max(1, self.ticks - before.ticks)


def run(cases: int, folder: Path, seed: int, advance: Callable[[int], None]) -> dict[str, Any]:
    """Attack real processes with `cases` cases; call `advance` with the number of cases so far.

    Returns
    -------
    The counts, `missed` (whether a bound of slips or work is exceeded) and `faults` (all others).

    Raises
    ------
    OracleError for a case without an answer. LiveError if a process does not start.
    """
    scenario = at_rates(load("target_leo"), RATE_HZ, IMU_RATE_HZ)
    setup = prepare(scenario, seed, folder, real_time=True, telemetry={"port": 0})
    plant_file = folder / "plant.yaml"
    write_yaml(plant_file, plant_document(scenario, seed, folder, setup.bus_ports))
    config = setup.config
    robot = config.resolve(config.robot.urdf).read_text(encoding="utf-8")
    grammar = Grammar(tuple(joint.name for joint in config.joints), robot, WITHOUT)
    state = config.resolve(config.service.state_directory)
    with (
        started_plant(plant_file, folder),
        process_of("daemon", ["-m", "fsw", "run", "--cold", str(setup.config_path)], folder) as d,
    ):
        target = LiveTarget(grammar, state, _port(state))
        try:
            result = _attack(target, d.pid, state, cases, seed, advance)
        finally:
            target.close()
        if d.poll() is not None:
            result["faults"].append("the loop process has ended")
    return result


def _attack(
    target: LiveTarget,
    loop: int,
    state: Path,
    cases: int,
    seed: int,
    advance: Callable[[int], None],
) -> dict[str, Any]:
    pids = (loop, *processes_of(loop).values())
    marks = [_mark(state)]
    target.tick(round(QUIET_S * RATE_HZ))
    marks.append(_mark(state))
    rng, warm, began_s = random.Random(seed), None, time.monotonic()
    while target.counts["cases"] < cases:
        play(target, rng.randbytes(INPUT_BYTES))
        advance(target.counts["cases"])
        if warm is None and target.counts["cases"] >= cases // 10:
            warm = [resident_bytes(pid) / 2**20 for pid in pids]
    attacked_s = time.monotonic() - began_s
    grown = [resident_bytes(p) / 2**20 - mb for p, mb in zip(pids, warm or (), strict=True)]
    target.tick(100)  # until the status file shows the end of the attack
    marks.append(_mark(state))
    target.tick(round(QUIET_S * RATE_HZ))
    marks.append(_mark(state))
    before, attacked, after = (b.since(a) for a, b in pairwise(marks))
    own = dict(zip(STRETCHES, (b.own_since(a) for a, b in pairwise(marks)), strict=True))
    faults = []
    if set(pids[1:]) != set(processes_of(loop).values()):
        faults.append("a process of the daemon has ended")
    if max(grown) > MOST_GROWTH_MB:
        faults.append("memory has grown")
    return {
        "seed": seed,
        **{name: target.counts[name] for name in ("cases", "telecommands", "accepted", "lines")},
        **{name: target.counts[name] for name in ("uploads", "damaged", "repaired")},
        "attacked_s": round(attacked_s, 1),
        "slips_per_1000_ticks": dict(zip(STRETCHES, (before, attacked, after), strict=True)),
        "over_budget_per_1000_ticks": own,
        "growth_mb": {"loop": round(grown[0], 1), "service": round(grown[1], 1)},
        "missed": attacked > max(before, after) + MOST_MORE_SLIPS
        or own["attacked"] > max(own["before"], own["after"]) + MOST_MORE_OWN,
        "faults": faults,
    }


def _port(state: Path) -> int:
    """Wait for the link; return its TCP port. Raises LiveError after START_S."""
    until_s = time.monotonic() + START_S
    while time.monotonic() < until_s:
        status = read_status(state / "status.json")
        port = int((status or {}).get("telemetry", {}).get("port") or 0)
        if port:
            return port
        time.sleep(0.1)
    raise LiveError("the daemon opens no link")


def _mark(state: Path) -> Mark:
    status = read_status(state / "status.json")
    if status is None:
        raise LiveError("the daemon has no status")
    return Mark(int(status["ticks"]), int(status["slips"]), int(status["over_budget"]))
