"""Target of the state directory: files with a right check value and any content."""

import atexit
import json
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path

from evidence.fuzz.oracle import Target, require
from file_delivery.slots import SlotFile
from fsw.errors import ConfigError
from fsw.telemetry.link.sdls_numbers import NUMBERS_NAME, NumberStore
from fsw.telemetry.state.boot import Boot
from fsw.telemetry.state.journal import Journal
from fsw.telemetry.state.packet_store import read_segment, split_packets
from fsw.telemetry.state.parameter_values import stored_values
from fsw.telemetry.state.store import GenerationStore


def state_target() -> Target:
    """Return the target; an input is the content of every kind of file of the state directory."""
    folder = Path(tempfile.mkdtemp(prefix="fuzz_state_"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)

    def one(data: bytes) -> None:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        for name in ("boot", "parameters"):
            GenerationStore(folder / name).write(data)
        boot = Boot.begin(GenerationStore(folder / "boot"), resume=False)
        require(boot.count >= 1 and bool(boot.text()), "no start", boot)
        values, damaged = stored_values(GenerationStore(folder / "parameters"))
        require(isinstance(values, dict) and damaged >= 0, "no values", values)
        for name in ("events.jsonl", "damaged", "segment"):
            (folder / name).write_bytes(data)
        with suppress(ValueError, RecursionError):
            SlotFile(folder / NUMBERS_NAME).write(json.loads(data))
        lines = Journal(folder / "events.jsonl", 1 << 20)
        held = lines.read()
        lines.append({"a": 1})
        require(lines.read()[-1] == {"a": 1}, "the line after a damaged one is lost", held)
        for name in ("damaged", NUMBERS_NAME):
            with suppress(ConfigError):  # in words
                require(NumberStore(folder / name).floor("f") >= 0, "a number below zero")
        with suppress(ValueError):
            _, packets = read_segment(folder / "segment")
            with packets:
                require(sum(len(p) for _, p in split_packets(packets)) <= len(data), "more packets")

    return one
