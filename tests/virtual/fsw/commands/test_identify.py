"""`fsw identify` without a recursion beside it."""

from __future__ import annotations

import pytest

from fsw.commands.identify import identify
from fsw.config import load
from fsw.estimators.recursive.online import OnlineEstimator


def test_what_fits_throughout_needs_no_recursion(flown, monkeypatch: pytest.MonkeyPatch):
    path, config = flown / "recording.mcap", load(flown / "flight.yaml")
    beside = identify(path, config, "rda", (), show=lambda *_: None)

    def never(*_: object) -> None:
        raise AssertionError("a block reached the recursion")

    monkeypatch.setattr(OnlineEstimator, "push", never)
    alone = identify(path, config, "rda", ())
    del alone["wall_s"], beside["wall_s"]
    assert alone == beside
    assert alone["status"] == "OK"
