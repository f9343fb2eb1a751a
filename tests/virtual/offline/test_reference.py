"""`fsw identify --reference`: a second recording tells arm and calibration."""

from typing import Any

import pytest

from fsw.__main__ import main
from fsw.config import load
from offline import identify as module


def test_the_windows_of_the_reference_reach_the_batch(flown, monkeypatch: pytest.MonkeyPatch):
    path, seen = flown / "recording.mcap", {}

    def batch(_config: object, blocks: list[Any], *_: object, reference: list[Any]) -> dict:
        seen.update(loaded=len(blocks), empty=len(reference))
        return {}

    monkeypatch.setattr(module, "run_batch", batch)
    module.identify(path, load(flown / "flight.yaml"), "fused", (), reference=path)
    assert seen["empty"] == seen["loaded"] > 0


def test_a_reference_with_the_target_in_it_is_refused_in_one_line(flown, capsys):
    path = str(flown / "recording.mcap")
    config = str(flown / "flight.yaml")
    assert main(["identify", path, "--config", config, "--reference", path]) == 1
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert "the reference" in last
