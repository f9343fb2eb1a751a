"""The short form of `python -m hil.evidence.fuzz.telemetry`, and that it would notice."""

import pytest
from rich.console import Console
from rich.progress import Progress

from fsw.telemetry.services.executor import TelecommandExecutor
from hil.evidence.fuzz.telemetry import FuzzError, configuration, run


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    return configuration(tmp_path_factory.mktemp("fuzz"))


@pytest.fixture
def progress():
    with Progress(console=Console(quiet=True)) as progress:
        yield progress


def test_nothing_that_is_no_telecommand_has_an_effect(config, progress):
    told = run(config, 50_000, 2_000, 7, progress)
    assert told["damaged"] == 1_000
    assert told["accepted"] + told["rejected"] == 1_000
    assert told["accepted"] > 0


def test_a_rejection_that_is_not_counted_is_noticed(config, progress, monkeypatch):
    monkeypatch.setattr(TelecommandExecutor, "_reject", lambda *_args, **_more: None)
    with pytest.raises(FuzzError, match="counted"):
        run(config, 0, 50, 7, progress)


def test_a_refusal_that_is_not_counted_is_noticed(config, progress, monkeypatch):
    monkeypatch.setattr(TelecommandExecutor, "refuse", lambda *_args, **_more: None)
    with pytest.raises(FuzzError, match="counted"):
        run(config, 0, 50, 7, progress)


def test_a_rejected_telecommand_with_an_effect_is_noticed(config, progress, monkeypatch):
    reject = TelecommandExecutor._reject

    def effective(self, *arguments, **more):
        reject(self, *arguments, **more)
        self._handlers["DISABLE_MONITORING"](None)()

    monkeypatch.setattr(TelecommandExecutor, "_reject", effective)
    with pytest.raises(FuzzError, match="effect"):
        run(config, 0, 50, 7, progress)
