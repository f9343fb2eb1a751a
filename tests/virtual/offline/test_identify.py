"""`fsw identify` without a recursion beside it."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import yaml

from fsw.__main__ import main
from fsw.config import load
from fsw.estimators.batch import run
from fsw.estimators.recursive.online import OnlineEstimator
from offline import identify as command
from offline.identify import identify


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


def test_one_window_too_few_is_said_of_the_number_of_windows(flown, tmp_path, capsys):
    """Not of the motion, which is the same as in the test before."""
    recording, config = flown / "recording.mcap", load(flown / "flight.yaml")
    data = yaml.safe_load((flown / "flight.yaml").read_text())
    least = identify(recording, config, "rda", ())
    count = round(least["duration_s"] / config.estimator.window_s)
    data["estimator"] = data.get("estimator", {}) | {"settle_blocks": count + 1}
    data["robot"]["urdf"] = str(flown / data["robot"]["urdf"])
    path = tmp_path / "robot.yaml"
    path.write_text(yaml.safe_dump(data))
    for name, *options in (["identify", "--method", "rda"], ["replay"]):
        main([name, str(recording), "--config", str(path), *options])
        said = capsys.readouterr().out
        assert "TOO_FEW_BLOCKS" in said
        assert f"windows are used; a result needs {count + 1} (estimator.settle_blocks)" in said
        assert "hardly narrow" not in said


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


def test_one_run_prints_and_writes_and_says_what_share_is_done(flown, tmp_path, capsys):
    out, page = tmp_path / "result.json", tmp_path / "page.html"
    words = [str(flown / "recording.mcap"), "--config", str(flown / "flight.yaml")]
    code = main(["identify", *words, "--out", str(out), "--report", str(page), "--method", "mrnea"])
    printed = capsys.readouterr()
    result = json.loads(out.read_text())
    assert code == (0 if result["status"] == "OK" else 1)
    assert f"target.mass_kg: {result['estimate']['target']['mass_kg']:.6g}" in printed.out
    assert page.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert re.search(r"10 s replayed \(\d+%\)", printed.err)
    assert "iteration" not in printed.err
    assert not list(tmp_path.glob("*.unfinished"))


def test_a_result_that_cannot_be_written_is_one_line(flown, tmp_path, capsys):
    (out := tmp_path / "result.json.unfinished").symlink_to("/dev/full")
    words = [str(flown / "recording.mcap"), "--config", str(flown / "flight.yaml"), "--to", "8"]
    argument = str(out.with_suffix(""))
    assert main(["identify", *words, "--method", "mrnea", "--out", argument]) == 2
    (*_, line) = capsys.readouterr().err.splitlines()
    assert "result.json cannot be written: No space left on device" in line
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("leaves_out", [False, True])
def test_a_batch_is_solved_again_only_where_screening_has_left_something_out(
    flown, monkeypatch: pytest.MonkeyPatch, leaves_out
):
    """Data that contradict the model in every window have nothing that could be left out."""
    path, config = flown / "recording.mcap", load(flown / "flight.yaml")
    solved = []

    def counted(*arguments, **options):
        solved.append(arguments)
        return run.run_batch(*arguments, **options)

    def screened(_config, blocks):
        none = np.zeros_like(blocks[0].has_joint)
        return [replace(blocks[0], has_joint=none) if leaves_out else blocks[0], *blocks[1:]]

    monkeypatch.setattr(command, "run_batch", counted)
    monkeypatch.setattr(command, "fits_throughout", lambda *_: False)
    monkeypatch.setattr(command, "screened", screened)
    identify(path, config, "mrnea", ())
    assert len(solved) == 1 + leaves_out
