"""The subcommands that print: telecommands with their reports, telemetry, command history."""

import argparse
import json
import math
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from ground.commands import MULTIPLE, TOGETHER, Argument, Catalogue, given_arguments
from ground.downlink import PacketStream
from ground.errors import LinkError, UsageError
from ground.history import CommandHistory
from ground.link import Link
from ground.sdls import Sealer
from ground.telemetry import UNKNOWN, Sample, TelemetryDecoder, check_names
from ground.utc import Correlation
from ground.verification import EXIT_CODES, Verification, VerificationOutcome, follow

ASKED_FOR_SET = "REPORT_SET"
PING = "PING"
SYNCHRONISE_S = 10.0


def opened(
    arguments: argparse.Namespace, sealer: Sealer | None, stream: PacketStream | None
) -> Link:
    """Open a link; if its key is new here, first find the key's next number."""
    link = Link(arguments.host, arguments.port, sealer, stream)
    if sealer is not None and sealer.is_new and link.stream.is_authenticated:
        _synchronise(link)
    return link


@contextmanager
def connected(
    arguments: argparse.Namespace, sealer: Sealer | None, stream: PacketStream | None
) -> Iterator[Link]:
    """Open a link for a `with` block; report rejected frames at the end and close the link."""
    link = opened(arguments, sealer, stream)
    try:
        yield link
        if link.stream.rejected:
            text = f"{link.stream.rejected} frames were not authentic, or repeated"
            print(f"ground: {text}", file=sys.stderr)
    finally:
        link.close()


def _synchronise(link: Link) -> None:
    """Find the next number of a key that is new here by a PING, which changes nothing on board."""
    ping = Catalogue().build(PING, {}, link.next_sequence())
    for _ in follow(link, TelemetryDecoder(), ping, SYNCHRONISE_S):
        pass


def list_commands(arguments: argparse.Namespace) -> int:
    """List all telecommands, or one with its arguments."""
    catalogue, name = Catalogue(), arguments.name
    if name is None:
        for command in catalogue.commands.values():
            print(f"{command.service:3d},{command.subtype:<3d} {command.name:32s} {command.doc}")
        print(f"{'':8s}{MULTIPLE:32s} {TOGETHER}")
        return 0
    if name.upper() == MULTIPLE:
        print(f"{MULTIPLE}: {TOGETHER}")
        for setting, command in catalogue.settings().items():
            print(f"  {setting}: {_argument_words(command.arguments[0])}")
        return 0
    command = catalogue.find(name)
    print(f"{command.name} ({command.service},{command.subtype}): {command.doc}")
    if command.warning:
        print(f"  {command.significance}: {command.warning}")
    for argument in command.arguments:
        print(f"  {argument.name}: {_argument_words(argument)}")
    return 0


def send(arguments: argparse.Namespace, sealer: Sealer | None, stream: PacketStream | None) -> int:
    """Send a telecommand once, show its reports and answers, return the exit code."""
    catalogue, decoder = Catalogue(), TelemetryDecoder()
    given = given_arguments(arguments.arguments)
    wanted = given.get("sid", "").lower() if arguments.name.upper() == ASKED_FOR_SET else ""
    checked = not arguments.force
    trial = catalogue.build(arguments.name, given, 0, checked=checked)  # fails before a link opens
    if arguments.on is not None:
        catalogue.on(trial, arguments.on, 0)
    with connected(arguments, sealer, stream) as link:
        packet = catalogue.build(arguments.name, given, link.next_sequence(), checked=checked)
        if arguments.at is not None:
            packet = catalogue.at(packet, arguments.at, link.next_sequence())
        if arguments.on is not None:
            packet = catalogue.on(packet, arguments.on, link.next_sequence())
        verification = follow_and_show(link, decoder, packet, arguments, wanted)
        target = f"{arguments.host}:{arguments.port}"
        words = " ".join(arguments.arguments)
        CommandHistory(arguments.state, target).add(arguments.name, words, verification, "tc")
    if arguments.json:
        print(json.dumps(_as_json(verification)))
    else:
        print(verification.outcome)
    if sealer is not None and verification.outcome is VerificationOutcome.REPEATED:
        print(f"ground: {_numbers_words(sealer, verification)}", file=sys.stderr)
    return EXIT_CODES[verification.outcome]


def show_number(arguments: argparse.Namespace, sealer: Sealer | None) -> int:
    """Show the next number of a key, or set it."""
    if sealer is None:
        raise UsageError("number: needs --key")
    if arguments.number is not None:
        sealer.set_next(arguments.number)
    print(sealer.next_number)
    return 0


def show_history(arguments: argparse.Namespace) -> int:
    """Show the newest commands in the history of this state folder."""
    for line in CommandHistory(arguments.state).read(arguments.count):
        if arguments.json:
            print(json.dumps(line))
            continue
        words = f"{line.get('command', '')} {line.get('arguments', '')}".strip()
        ending = f"{line.get('outcome', '')} {line.get('error', '')}".strip()
        print(f"{line.get('utc', '')}  {line.get('who', '')}  {words}: {ending}")
    return 0


def _numbers_words(sealer: Sealer, verification: Verification) -> str:
    """Return advice to the operator after a command was refused as repeated."""
    if verification.is_authenticated:
        return (
            f"the next number is {sealer.next_number} now, as the daemon says; it was not sent "
            "again: look at what the daemon has done first"
        )
    number = verification.expected_number
    return (
        f"a report that nothing authenticates says that number {number} comes next; it was not "
        "sent again and the numbers were left as they are. If you trust it: "
        f"ground --key FILE number {number}"
    )


def watch(arguments: argparse.Namespace, stream: PacketStream | None) -> int:
    """Show telemetry until `--count` or `--seconds`; show unknown packets raw and count them."""
    decoder = TelemetryDecoder()
    check_names(decoder.fields, arguments.packets, arguments.field)
    shown = unknown = 0
    dates = Correlation()
    with connected(arguments, None, stream) as link:
        raw_file = arguments.raw.open("wb") if arguments.raw is not None else None
        try:
            for raw in link.packets(time.monotonic() + arguments.seconds):
                if raw_file is not None:
                    raw_file.write(raw)
                sample = decoder.decode(raw)
                dates.take(sample)
                is_unknown = sample.packet == UNKNOWN
                unknown += is_unknown
                if arguments.packets and sample.packet not in arguments.packets:
                    continue
                fields = () if is_unknown else arguments.field
                utc = dates.text(sample.time_s)
                print(_line(sample, fields, as_json=arguments.json, utc=utc), flush=True)
                shown += 1
                if shown == arguments.count:
                    return 0
        finally:
            if raw_file is not None:
                raw_file.close()
            if unknown:
                print(f"ground: {unknown} packets are not in the dictionary", file=sys.stderr)
    if arguments.count is not None:
        raise LinkError(f"{shown} of {arguments.count} packets in {arguments.seconds:g} s")
    return 0


def follow_and_show(
    link: Link, decoder: TelemetryDecoder, packet: bytes, arguments: argparse.Namespace, wanted: str
) -> Verification:
    """Send one telecommand, show its reports and answers, and return its verification."""
    begun_s = time.monotonic()
    verification = Verification(request=(0, 0))
    for verification, sample in follow(link, decoder, packet, arguments.timeout, wanted):  # noqa: B007
        if sample is None or arguments.json:
            continue
        if sample.service == 1:
            after_s = time.monotonic() - begun_s
            print(f"{after_s:8.3f} s  {_report_words(sample)}")
        else:
            print(f"            {_line(sample, (), as_json=False)}")
    return verification


def _report_words(sample: Sample) -> str:
    words = sample.packet.replace("_", " ")
    if "step" in sample.values:
        words += f" {sample.values['step']} %"
    if "error" in sample.values:
        words += f": {sample.values['error']}"
        if sample.values["error_argument"]:
            words += f", argument {sample.values['error_argument']}"
        if sample.values["error_value"]:
            words += f", {sample.values['error_value']:g}"
    return words


def _line(sample: Sample, fields: Sequence[str], *, as_json: bool, utc: str | None = None) -> str:
    chosen = {k: v for k, v in sample.values.items() if not fields or k in fields}
    if as_json:
        return json.dumps(_sample_json(sample) | {"utc": utc, "values": chosen})
    when = "" if math.isnan(sample.time_s) else f"{sample.time_s:.3f} s  "
    when += f"{utc}  " if utc is not None else ""
    return f"{when}{sample.packet}  " + "  ".join(
        f"{k}={v:g}" if isinstance(v, float) else f"{k}={v}" for k, v in chosen.items()
    )


def _sample_json(sample: Sample) -> dict[str, Any]:
    time_s = None if math.isnan(sample.time_s) else sample.time_s
    return {"packet": sample.packet, "time_s": time_s, "values": dict(sample.values)}


def _as_json(verification: Verification) -> dict[str, Any]:
    return {
        "outcome": str(verification.outcome),
        "completed": verification.outcome is VerificationOutcome.COMPLETED,
        "reports": [_sample_json(sample) for sample in verification.reports],
        "answers": [_sample_json(sample) for sample in verification.answers],
    }


def _argument_words(argument: Argument) -> str:
    if argument.labels is not None:
        return f"one of {', '.join(argument.labels)}" + (
            f"; {argument.doc}" if argument.doc else ""
        )
    words = {"binary": "bytes: hex digits or @FILE", "string": f"text, {argument.bits // 8} bytes"}
    text = words.get(argument.kind, f"{argument.kind} {argument.low:g} to {argument.high:g}")
    return f"{text}; {argument.doc}" if argument.doc else text
