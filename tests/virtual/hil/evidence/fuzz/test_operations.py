"""The short form of `hil fuzz --only operations`, and that its oracle would notice."""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path

import pytest

from fsw.loop.command_queue import CommandQueue
from fsw.telemetry.services.executor import TelecommandExecutor
from hil.evidence.fuzz.operations import OperationsBench, play
from hil.evidence.fuzz.oracle import OracleError
from hil.evidence.fuzz.seeds import seeds

CASES = 4_000
INPUT_BYTES = 120


@pytest.fixture
def spoilt(tmp_path: Path) -> Iterator[OperationsBench]:
    """A bench for what leaves answers behind."""
    bench = OperationsBench(tmp_path)
    yield bench
    bench.close()


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[OperationsBench]:
    bench = OperationsBench(tmp_path_factory.mktemp("operations"))
    yield bench
    bench.close()


def test_an_error_nobody_foresaw_is_noticed(
    spoilt: OperationsBench, monkeypatch: pytest.MonkeyPatch
):
    def unforeseen(*_arguments: object) -> None:
        raise RuntimeError("nobody foresaw this")

    monkeypatch.setattr(CommandQueue, "_execute", unforeseen)
    with pytest.raises(OracleError, match="nobody foresaw"):
        spoilt.line(b'{"command": "reset"}')


def test_a_telecommand_that_is_not_answered_is_noticed(
    spoilt: OperationsBench, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(TelecommandExecutor, "_success", lambda *_arguments: None)
    with pytest.raises(OracleError, match="not answered"):
        spoilt.command("PING")


def test_what_has_ended_a_daemon_once_does_not_any_more(bench: OperationsBench):
    for data in seeds("operations"):
        play(bench, data)


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_hostile_operations_are_answered_and_end_nothing(bench: OperationsBench):
    rng = random.Random(7)
    bench.counts.clear()
    while bench.counts["cases"] < CASES:
        play(bench, rng.randbytes(INPUT_BYTES))
    for name in ("accepted", "lines", "uploads", "blocks", "TABLE_ACTIVATED", "TABLE_INVALID"):
        assert bench.counts[name] > 0, name


def test_the_corpus_of_a_campaign_still_passes(bench: OperationsBench):
    for path in sorted((Path(__file__).parents[4] / "corpus" / "operations").iterdir()):
        play(bench, path.read_bytes())
