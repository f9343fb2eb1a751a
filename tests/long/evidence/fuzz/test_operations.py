"""The short form of `hil fuzz --only operations`, and that its oracle would notice."""

import random
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from evidence.fuzz import damage, many
from evidence.fuzz.choices import Choices
from evidence.fuzz.daemon_bench import OperationsBench
from evidence.fuzz.damage import damaged_packet, repaired_packet
from evidence.fuzz.many import BLOCK_CASES, blocks, summary
from evidence.fuzz.operations import fresh_folder, play
from evidence.fuzz.oracle import OracleError
from evidence.fuzz.seeds import seeds
from evidence.store import Store
from fsw.estimation.dispatcher import Dispatcher
from fsw.telemetry.services.executor import TelecommandExecutor

CASES = 20_000  # `hil fuzz --only operations --random` plays a million
WARM_CASES = 10_000  # until stores and logs have reached their bounds
MOST_GROWTH_MB = 4.0  # afterwards, over all cases


@pytest.fixture
def spoilt(tmp_path: Path) -> Iterator[OperationsBench]:
    """A bench for what leaves answers behind."""
    bench = OperationsBench(tmp_path)
    yield bench
    bench.close()


@pytest.fixture(scope="module")
def bench() -> Iterator[OperationsBench]:
    folder = fresh_folder()
    bench = OperationsBench(folder)
    yield bench
    bench.close()
    shutil.rmtree(folder)


def test_an_error_nobody_foresaw_is_noticed(
    spoilt: OperationsBench, monkeypatch: pytest.MonkeyPatch
):
    def unforeseen(*_arguments: object) -> None:
        raise RuntimeError("nobody foresaw this")

    monkeypatch.setattr(Dispatcher, "_execute", unforeseen)
    with pytest.raises(OracleError, match="nobody foresaw"):
        spoilt.line(b'{"command": "reset"}')


def test_a_telecommand_that_is_not_answered_is_noticed(
    spoilt: OperationsBench, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(TelecommandExecutor, "_success", lambda *_arguments: None)
    with pytest.raises(OracleError, match="not answered"):
        spoilt.command("PING")


def uncounted(self: TelecommandExecutor, *_arguments: object, **_more: object) -> None:
    """Refuse without counting it."""


def test_a_refusal_that_is_not_counted_is_noticed(
    spoilt: OperationsBench, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(TelecommandExecutor, "refuse", uncounted)
    with pytest.raises(OracleError, match="not counted"):
        give_changed(spoilt, damaged_packet)


def test_a_valid_packet_that_completes_a_cut_one_is_no_failure(
    spoilt: OperationsBench, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(damage, "damage", lambda packet, _choices: packet[:8])
    packet = bytes.fromhex("1864ce5700062f0c0f0000d951")
    assert damage.is_whole((packet[:8] + damage.PING)[: len(packet)])
    damaged_packet(spoilt, packet, Choices(b""))


def test_a_rejection_that_is_not_counted_is_noticed(
    spoilt: OperationsBench, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(TelecommandExecutor, "_reject", uncounted)
    with pytest.raises(OracleError, match="not counted"):
        give_changed(spoilt, repaired_packet)


def test_a_rejected_telecommand_with_an_effect_is_noticed(
    spoilt: OperationsBench, monkeypatch: pytest.MonkeyPatch
):
    reject = TelecommandExecutor._reject

    def effective(self: TelecommandExecutor, *arguments: Any, **more: Any) -> None:
        reject(self, *arguments, **more)
        self._handlers["DISABLE_MONITORING"](None)()

    monkeypatch.setattr(TelecommandExecutor, "_reject", effective)
    with pytest.raises(OracleError, match="effect"):
        give_changed(spoilt, repaired_packet)


def give_changed(
    bench: OperationsBench, change: Callable[[OperationsBench, bytes, Choices], None]
) -> None:
    """Give fifty changed telecommands."""
    rng = random.Random(7)
    for _ in range(50):
        choices = Choices(rng.randbytes(200))
        change(bench, bench.grammar.telecommand(choices, bench.sequence()), choices)


def test_what_has_ended_a_daemon_once_does_not_any_more(bench: OperationsBench):
    for data in seeds("operations"):
        play(bench, data)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_hostile_operations_are_answered_and_end_nothing():
    store = Store(None, {})
    for block in blocks(CASES, 7, store):
        assert block.failure == ""
    found = summary(store)
    assert found["cases"] >= CASES
    rows = list(store.rows.values())
    warm = rows[WARM_CASES // BLOCK_CASES - 1]
    assert rows[-1]["resident_mb"] - warm["resident_mb"] < MOST_GROWTH_MB
    happened = ("accepted", "lines", "uploads", "blocks", "TABLE_ACTIVATED", "TABLE_INVALID")
    changed = ("damaged", "repaired_accepted", "repaired_rejected")
    for name in (*happened, *changed):
        assert found["happened"][name] > 0, name


def test_a_failure_ends_the_blocks_with_its_input(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(TelecommandExecutor, "_success", lambda *_arguments: None)
    (block,) = blocks(2 * BLOCK_CASES, 1, store := Store(None, {}))
    data, text = block.failure.split(": ", 1)
    assert bytes.fromhex(data)
    assert "not answered" in text
    assert not store.rows


def test_a_block_is_the_same_when_it_is_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(many, "BLOCK_CASES", 100)
    whole = {block.number: block.cases for block in blocks(200, 5, Store(None, {}))}
    first = next(blocks(200, 5, Store(tmp_path, {})))
    rest = {block.number: block.cases for block in blocks(200, 5, Store(tmp_path, {}))}
    assert {first.number: first.cases} | rest == whole
    assert sorted(rest) == [1]


def test_the_corpus_of_a_campaign_still_passes(bench: OperationsBench):
    for path in sorted((Path(__file__).parents[3] / "corpus" / "operations").iterdir()):
        play(bench, path.read_bytes())
