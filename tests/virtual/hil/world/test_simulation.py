"""A kept truth is the simulated one to the bit, and belongs to its arguments alone."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from hil.run.bench import prepare
from hil.world import simulation
from hil.world.history import TruthHistory
from hil.world.scenario import load
from hil.world.simulation import simulate_in


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HIL_TRUTH_CACHE", str(tmp_path))
    return tmp_path


def same(a: TruthHistory, b: TruthHistory) -> bool:
    t_s = np.linspace(0.1, 0.9, 7)
    found, wanted = a.at(t_s), b.at(t_s)
    names = [field.name for field in fields(wanted)]
    return all(np.array_equal(getattr(found, n), getattr(wanted, n)) for n in names)


@pytest.mark.parametrize("scenario", ["target_leo", "target_leo_orbit", "mev"])
def test_a_truth_is_kept_to_the_bit(
    scenario: str, folder: Path, tmp_path_factory: pytest.TempPathFactory
):
    setup = prepare(load(scenario), 1, tmp_path_factory.mktemp("flight"))
    (kept,) = folder.iterdir()
    again = prepare(load(scenario), 2, tmp_path_factory.mktemp("flight"))
    assert list(folder.iterdir()) == [kept]
    assert same(again.history, setup.history)


def test_other_arguments_and_a_damaged_file_are_simulated(
    folder: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
):
    setup = prepare(load("target_leo"), 1, tmp_path_factory.mktemp("flight"))
    (whole,) = folder.iterdir()
    robot, spline = setup.robot, setup.spline
    short = simulate_in(None, robot, spline, 0.0, 1.0)
    assert same(short, simulate_in(None, robot, spline, 0.0, 1.0))
    (path,) = set(folder.iterdir()) - {whole}
    path.write_bytes(path.read_bytes()[:1000])
    assert same(simulate_in(None, robot, spline, 0.0, 1.0), short)
    turning = simulate_in(None, robot, spline, 0.0, 1.0, w_NB_B_rad_s=(0.01, 0.0, 0.0))
    assert not same(turning, short)
    monkeypatch.setattr(simulation, "_code", lambda: b"another version")
    before = len(list(folder.iterdir()))
    simulate_in(None, robot, spline, 0.0, 1.0)
    assert len(list(folder.iterdir())) == before + 1
