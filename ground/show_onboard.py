"""The subcommands for data stored on board: playback of telemetry, and sequences."""

import argparse
import secrets
import zlib
from collections.abc import Callable, Mapping
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory

from ground.commands import Catalogue
from ground.downlink import PacketStream
from ground.errors import UsageError
from ground.files import Files
from ground.link import COUNT_14, Link
from ground.playback import (
    LAST_S,
    STORES,
    Range,
    missing_ranges,
    new_packets,
    read_stream,
    retrieve,
)
from ground.sdls import Sealer
from ground.sequence import DIRECT_BYTES, compile_sequence
from ground.show import connected, follow_and_show, opened
from ground.telemetry import TelemetryDecoder
from ground.verification import EXIT_CODES, VerificationOutcome

PIECE_BYTES = 1 << 20  # size of a piece of an uploaded file


def play_back(
    arguments: argparse.Namespace, sealer: Sealer | None, stream: PacketStream | None
) -> int:
    """Retrieve stored packets into a file (`--missed`: its gaps only); return the exit code."""
    stores = [name.upper() for name in arguments.stores] or list(STORES)
    wrong = [name for name in stores if name not in STORES]
    if wrong:
        raise UsageError(f"{wrong[0]}: no such packet store; one of {', '.join(STORES)}")
    path, known, ranges = _what(arguments)
    catalogue, decoder, code, added = Catalogue(), TelemetryDecoder(), 0, 0
    with connected(arguments, sealer, stream) as link, path.open("ab") as file:
        for store in stores:
            for wanted in ranges[store]:
                verification, came = retrieve(
                    link, catalogue, decoder, store, wanted, arguments.timeout
                )
                fresh = new_packets(known, came)
                known += fresh
                file.write(b"".join(fresh))
                added += len(fresh)
                end = "now" if wanted.to_s == LAST_S else f"{wanted.to_s:.3f} s"
                words = f"{store} {wanted.from_s:.3f} s to {end}: {len(fresh)} packets"
                print(f"{words}, {verification.outcome}")
                code = code or EXIT_CODES[verification.outcome]
    print(f"{path}: {added} packets added")
    return code


def _what(
    arguments: argparse.Namespace,
) -> tuple[Path, list[bytes], Mapping[str, list[Range]]]:
    """Return the file to extend, its packets, and the ranges to request by packet store."""
    if arguments.missed is not None:
        known = read_stream(arguments.missed)
        return arguments.missed, known, missing_ranges(known)
    if arguments.out is None:
        raise UsageError("playback: give --out FILE, or --missed FILE")
    if arguments.start > arguments.end:
        raise UsageError(f"--from {arguments.start:g}: is after --to {arguments.end:g}")
    known = read_stream(arguments.out) if arguments.out.exists() else []
    wanted = Range(arguments.start, arguments.end)
    return arguments.out, known, {store: [wanted] for store in STORES}


def load_sequence(
    arguments: argparse.Namespace, sealer: Sealer | None, stream: PacketStream | None
) -> int:
    """Load a sequence from a text file, start it if requested, and return the exit code."""
    catalogue, decoder = Catalogue(), TelemetryDecoder()
    try:
        text = arguments.file.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{arguments.file}: {error}") from error
    counts = count(secrets.randbelow(COUNT_14))
    data = compile_sequence(text, catalogue, lambda: next(counts) % COUNT_14)
    number = {"sequence": str(arguments.number)}
    name, given = "LOAD_SEQUENCE", {**number, "entries": data.hex()}
    catalogue.build(name, given, 0)  # a wrong number fails before a link is opened
    if len(data) > DIRECT_BYTES:
        path = _upload(arguments, data, lambda: opened(arguments, sealer, stream))
        name, given = "LOAD_SEQUENCE_FILE", {**number, "path": path}
    commands = [(name, given), *([("START_SEQUENCE", number)] if arguments.start else [])]
    with connected(arguments, sealer, stream) as link:
        for name, given in commands:
            packet = catalogue.build(name, given, link.next_sequence())
            verification = follow_and_show(link, decoder, packet, arguments, "")
            print(f"{name}: {verification.outcome}")
            if verification.outcome is not VerificationOutcome.COMPLETED:
                return EXIT_CODES[verification.outcome]
    return 0


def _upload(arguments: argparse.Namespace, data: bytes, make_link: Callable[[], Link]) -> str:
    """Upload the entries as a file; return the file's path on board."""
    name = f"sequence_{arguments.number}_{zlib.crc32(data):08x}.bin"
    with TemporaryDirectory(prefix="ground-") as folder:
        path = Path(folder) / name
        path.write_bytes(data)
        given = {"remote": name, "local": path, "piece": PIECE_BYTES, "wait": arguments.timeout}
        wanted = argparse.Namespace(**vars(arguments), **given)
        Files(wanted, make_link).put()
    return f"files/{name}"
