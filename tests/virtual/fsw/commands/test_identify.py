"""`fsw identify` without a recursion beside it."""

import numpy as np
import pytest

from fsw.commands.identify import identify
from fsw.config import load
from fsw.estimators.batch import run
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


def test_a_warm_start_from_some_blocks_ends_at_the_same_estimate(
    flown, monkeypatch: pytest.MonkeyPatch
):
    path, config = flown / "recording.mcap", load(flown / "flight.yaml")
    every = identify(path, config, "rda", ())
    monkeypatch.setattr(run, "WARM_BLOCKS", 8)
    some = identify(path, config, "rda", ())
    root = np.linalg.cholesky(every["covariance"])
    off = np.linalg.solve(root, np.subtract(some["mean"], every["mean"]))
    assert 0.0 < np.abs(off).max() < 1e-6
