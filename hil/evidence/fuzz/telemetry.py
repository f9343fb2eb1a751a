"""Fuzzing of the telecommand path with damaged packets: `python -m hil.evidence.fuzz.telemetry`.

Random bytes, then valid telecommands of every kind changed: bits flipped, ends cut off; and bytes
changed, taken out, put in or repeated with the check value made right again. What must hold:
nothing raises; every byte is part of a packet, skipped, or still waiting; every packet is counted
once, as accepted or as rejected; what is rejected is an event and changes nothing else.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from fastcrc import crc16
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from fsw.config import Config
from fsw.messages.commands import Command
from fsw.telemetry.application import TelemetryApplication
from fsw.telemetry.assembly import build_application
from fsw.telemetry.dictionary import DICTIONARY, Field, Telecommand, Type
from fsw.telemetry.link.packets import parameters_data, telecommand_packet
from fsw.telemetry.link.splitter import PATIENCE_NS, Uplinked
from fsw.telemetry.link.telecommands import PARAMETERS
from fsw.telemetry.link.uplink import ClearUplink
from fsw.telemetry.ports import Host
from fsw.telemetry.state.epoch import Epoch
from hil.run.bench import prepare
from hil.world.scenario import load as load_scenario

CHUNK = 4096
PING = telecommand_packet(DICTIONARY.telecommand("PING"), {}, 1)
Advance = Callable[[int], None]


class FuzzError(RuntimeError):
    """A required property is violated; the message contains the bytes sent."""


class _Recording:
    """A recorder that only says that it is there."""

    path: Path | None = None

    def values(self) -> Mapping[str, Any]:
        """Return nothing recorded."""
        return dict.fromkeys(("recording", "failed_messages", "dropped_messages", "recordings"), 0)

    def start(self) -> None:
        """Do nothing."""

    def stop(self) -> None:
        """Do nothing."""


@dataclass(slots=True)
class TelemetryBench:
    """The application on a host that only counts."""

    config: Config
    now_ns: int = 10**12
    forwarded: int = 0
    events: int = 0
    app: TelemetryApplication = field(init=False)

    def __post_init__(self) -> None:
        host = Host(
            now_ns=lambda: self.now_ns,
            epoch=lambda: Epoch(clock_id="fuzz", utc_less_met_ns=0),
            forward=self._forward,
            report=self._report,
            configured=lambda _: None,
            recording=_Recording(),
        )
        self.app = build_application(self.config, host, resume=False)
        self.app.status({"identifying": False, "job": None})

    def _forward(self, _command: Command) -> bool:
        self.forwarded += 1
        return True

    def _report(self, _severity: str, _code: str, _text: str) -> None:
        self.events += 1

    def digest(self) -> str:
        """Return everything a telecommand can change, as text."""
        app = self.app
        state = (
            [app.context.parameter(item.name) for item in DICTIONARY.parameters],
            app.tables.values(),
            app.housekeeping.rates(),
            app.monitoring.table(),
            (app.onboard.digest(), app.monitoring.enabled),
            (app.modes.mode, app.supervision.health.latched, app.times.exponent),
            (self.forwarded, app.events.disabled),
        )
        return json.dumps(state, default=str)

    def counted(self) -> tuple[int, int]:
        """Return telecommands accepted and rejected so far."""
        counters = self.app.executor.counters
        return counters.tc_accepted, counters.tc_rejected

    def told(self) -> int:
        """Return events so far, those that became part of a summary included."""
        return self.events + self.app.context.reporter.summaries.held

    def take(self, found: list[Uplinked]) -> None:
        """Process rejected packets and file units as the service does. Raises FuzzError."""
        (accepted, rejected), events = self.counted(), self.told()
        refused = sum(not item.is_file for item in found)
        for item in found:
            self.app.receive(item, self.now_ns)
        if self.counted() != (accepted, rejected + refused) or self.told() != events + refused:
            raise FuzzError(f"{refused} refused, but not all of them counted and told: {found}")


def configuration(folder: Path) -> Config:
    """Return the flight configuration of a scenario with telemetry, in a folder of its own."""
    telemetry = {"port": 0, "housekeeping_interval_s": 0.0}
    return prepare(load_scenario("target_leo"), 1, folder, telemetry=telemetry).config


def random_bytes(
    bench: TelemetryBench, count: int, rng: np.random.Generator, advance: Advance
) -> int:
    """Feed random bytes; return how many packets were found in them. Raises FuzzError."""
    uplink, before, packets, in_packets = ClearUplink(), bench.digest(), 0, 0
    fed = 0
    while fed < count:
        chunk = rng.bytes(min(CHUNK, count - fed))
        fed += len(chunk)
        bench.now_ns += 10_000_000
        found = uplink.feed(chunk, bench.now_ns)
        while uplink.pending_bytes and fed == count:
            bench.now_ns += PATIENCE_NS
            found += uplink.expire(bench.now_ns)
            if uplink.pending_bytes < 6:  # less than a header is left
                break
        packets += len(found)
        in_packets += sum(len(item.packet) for item in found if item.error is None)
        bench.take(found)
        advance(fed)
    if uplink.skipped_bytes + in_packets + uplink.pending_bytes != count:
        raise FuzzError(f"{count} bytes, but {uplink.skipped_bytes} + {in_packets} + pending")
    if bench.digest() != before:
        raise FuzzError("random bytes had an effect")
    return packets


def valid_packet(telecommand: Telecommand, rng: np.random.Generator) -> bytes:
    """Return a telecommand with arguments the dictionary allows."""
    if telecommand.service == PARAMETERS:
        item = DICTIONARY.parameters[rng.integers(len(DICTIONARY.parameters))]
        data = parameters_data({item.id: item.default})
        values: dict[str, object] = {"count": 1, "parameter": item.id, "value": data[3:]}
    else:
        elements = telecommand.arguments[telecommand.repeats :]  # of a group there is one
        values = {f.name: _value(f, rng) for f in elements}
    return telecommand_packet(telecommand, values, int(rng.integers(1 << 14)))


def _value(item: Field, rng: np.random.Generator) -> object:
    if item.type is Type.BYTES:
        return rng.bytes(int(rng.integers(1, 40)))
    if item.type is Type.TEXT:
        return "files/x"
    if item.enumeration is not None:
        return int(rng.choice(list(item.enumeration.labels)))
    low = 0 if item.minimum is None else item.minimum
    high = 255 if item.maximum is None else item.maximum
    return low + (high - low) * rng.random() if item.type.startswith("f") else int(low)


def damaged(packet: bytes, rng: np.random.Generator) -> bytes:
    """Return the packet with damage that its check value always shows, or that cuts it."""
    data = bytearray(packet)
    kind = rng.integers(3)
    if kind == 0:  # up to three bits: the code's distance is four
        for bit in rng.choice(8 * len(data), size=int(rng.integers(1, 4)), replace=False):
            data[bit // 8] ^= 1 << (bit % 8)
    elif kind == 1:  # a burst of at most sixteen bits
        at = int(rng.integers(len(data) - 1))
        data[at] ^= int(rng.integers(1, 256))
        data[at + 1] ^= int(rng.integers(256))
    else:
        del data[int(rng.integers(1, len(data))) :]
    return bytes(data)


def repaired(packet: bytes, rng: np.random.Generator) -> bytes:
    """Return the packet with other bytes after its header, length and check value right again."""
    body = bytearray(packet[6:-2])
    for _ in range(int(rng.integers(1, 4))):
        kind, at = rng.integers(4), int(rng.integers(len(body)))
        if kind == 0:
            body[at] = int(rng.integers(256))
        elif kind == 1 and len(body) > 6:
            del body[at]
        elif kind == 2:
            body.insert(at, int(rng.integers(256)))
        else:
            body += body[at:]
    head = bytearray(packet[:4]) + (len(body) + 1).to_bytes(2, "big")
    whole = bytes(head + body)
    return whole + crc16.ibm_3740(whole).to_bytes(2, "big")


def mutants(
    bench: TelemetryBench, count: int, rng: np.random.Generator, advance: Advance
) -> dict[str, int]:
    """Give changed telecommands; return how many were accepted and rejected. Raises FuzzError."""
    known = DICTIONARY.telecommands
    tally = {"damaged": 0, "accepted": 0, "rejected": 0}
    for k in range(count):
        telecommand = known[rng.integers(len(known))]
        packet = valid_packet(telecommand, rng)
        if k % 2:
            bad = damaged(packet, rng)
            while (bad + PING).startswith(packet):  # what follows has put it right by chance
                bad = damaged(packet, rng)
            _give_damaged(bench, packet, bad)
            tally["damaged"] += 1
        else:
            tally["accepted" if _give(bench, repaired(packet, rng)) else "rejected"] += 1
        bench.now_ns += 1_000_000
        if k % 64 == 0:
            bench.app.poll(bench.now_ns)
            advance(k)
    return tally


def _give_damaged(bench: TelemetryBench, packet: bytes, bad: bytes) -> None:
    """Give a damaged packet and a good one after it: only the good one may count."""
    before = bench.digest()
    uplink = ClearUplink()
    found = uplink.feed(bad + PING, bench.now_ns)
    while uplink.pending_bytes >= len(PING):
        bench.now_ns += PATIENCE_NS
        found += uplink.expire(bench.now_ns)
    units = [item for item in found if item.is_file]  # have a check value of their own
    accepted = [i for i in found if i.error is None and not i.is_file and i.packet != PING]
    if accepted or not any(item.packet == PING for item in found):
        raise FuzzError(f"{packet.hex()} damaged to {bad.hex()}: {found}")
    bench.take([item for item in found if item.packet != PING])
    left = uplink.skipped_bytes + uplink.pending_bytes + sum(len(item.packet) for item in units)
    if left != len(bad) or bench.digest() != before:
        raise FuzzError(f"{bad.hex()}: not all of it was counted, or it had an effect")


def _give(bench: TelemetryBench, packet: bytes) -> bool:
    """Give a packet with a good check value; return whether it was accepted."""
    before, events, counts = bench.digest(), bench.told(), bench.counted()
    executor = bench.app.executor
    if executor.receive(packet):
        reset = executor.check(packet).telecommand.name == "RESET_COUNTERS"
        wanted = (0, 0) if reset else (counts[0] + 1, counts[1])
        if bench.counted() != wanted:
            raise FuzzError(f"{packet.hex()}: accepted, and counted {counts} to {bench.counted()}")
        return True
    if bench.counted() != (counts[0], counts[1] + 1) or bench.told() != events + 1:
        raise FuzzError(f"{packet.hex()}: rejected, and not counted or not told once")
    if bench.digest() != before:
        raise FuzzError(f"{packet.hex()}: rejected, and had an effect")
    return False


def run(config: Config, count: int, changed: int, seed: int, progress: Progress) -> dict[str, Any]:
    """Do both; return what became of it. Raises FuzzError."""
    rng = np.random.default_rng(seed)
    bench = TelemetryBench(config)
    bar = progress.add_task("random bytes", total=count)
    packets = random_bytes(bench, count, rng, partial(_advance, progress, bar))
    bar = progress.add_task("mutants", total=changed)
    tally = mutants(bench, changed, rng, partial(_advance, progress, bar))
    return {"seed": seed, "bytes": count, "packets_in_them": packets, "mutants": changed, **tally}


def _advance(progress: Progress, bar: TaskID, done: int) -> None:
    progress.update(bar, completed=done)


def main(argv: list[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(prog="hil.evidence.fuzz.telemetry", description=__doc__)
    parser.add_argument("--bytes", type=int, default=1_000_000, metavar="N")
    parser.add_argument("--mutants", type=int, default=100_000, metavar="N")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args(argv)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with (
        tempfile.TemporaryDirectory(prefix="fuzz-") as folder,
        Progress(*columns, console=Console(stderr=True)) as progress,
    ):
        config = configuration(Path(folder))
        told = run(config, arguments.bytes, arguments.mutants, arguments.seed, progress)
    sys.stdout.write(json.dumps(told) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
