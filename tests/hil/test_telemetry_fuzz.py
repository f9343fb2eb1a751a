"""The short form of `python -m hil.telemetry_fuzz`, and that it would notice."""

import pytest
from rich.console import Console
from rich.progress import Progress

from fsw.telemetry.dispatcher import TcDispatcher
from hil.telemetry_fuzz import FuzzError, run

pytestmark = pytest.mark.live


@pytest.fixture
def progress():
    with Progress(console=Console(quiet=True)) as progress:
        yield progress


def test_nothing_that_is_no_telecommand_has_an_effect(tmp_path, progress):
    told = run(tmp_path, 50_000, 2_000, 7, progress)
    assert told["damaged"] == 1_000
    assert told["accepted"] + told["rejected"] == 1_000
    assert told["accepted"] > 0


def test_a_rejection_that_is_not_counted_is_noticed(tmp_path, progress, monkeypatch):
    monkeypatch.setattr(TcDispatcher, "_reject", lambda *_args, **_more: None)
    with pytest.raises(FuzzError, match="counted"):
        run(tmp_path, 0, 50, 7, progress)
