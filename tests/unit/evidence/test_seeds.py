"""The summary of many seeds, on outcomes made by hand, and to which input results belong."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from scipy.stats import chi2

from evidence import provenance, runner
from evidence import seeds as many
from evidence.seeds import run_seeds, summary
from evidence.settings import content_of
from hil.__main__ import main
from hil.world.scenario import FOLDER, ScenarioError, load, names

OWN = FOLDER / "configurations"


def outcome(mass_kg: float, nees: float, wrong: int = 0) -> dict[str, Any]:
    return {
        "scenario": "s",
        "unknown": ["target"],
        "truth": {"target": {"mass_kg": 400.0}},
        "estimate": {"target": {"mass_kg": mass_kg}},
        "sigma": {"target": {"mass_kg": 1.0}},
        "mass_sigma_to_crb_ratio": {"target": 1.2},
        "mass_sigma_to_true_crb_ratio": {"target": 1.05},
        "nees": nees,
        "dof": 10,
        "valid": True,
        "outputs": {"valid": 150, "wrong": wrong},
        "ee_error": {"mean_position_m": 1e-5},
        "samples": {"imu": {"received": 9, "lost": 1, "late": 0, "rejected": 2}},
        "slips": 0,
        "simulated_s": 65.0,
        "wall_s": 13.0,
    }


def test_counts_and_band_are_those_of_the_runs() -> None:
    total = summary([outcome(400.5, 8.0), outcome(402.0, 14.0, 3), outcome(396.0, 11.0)])
    assert total["mean_nees"] == pytest.approx(11.0)
    assert total["nees_band_99"][0] == pytest.approx(chi2.ppf(0.005, 30) / 3)
    assert total["bodies"]["target"]["within_0.3_percent"] == 1
    assert total["bodies"]["target"]["within_3_sigma"] == 2
    assert total["bodies"]["target"]["worst_mass_error_ratio"] == pytest.approx(0.01)
    assert (total["lost"], total["rejected"], total["late"]) == (3, 6, 0)
    assert total["ever_valid_and_wrong"] == 1
    assert total["slowest_speed_ratio"] == pytest.approx(5.0)


def own(folder: Path) -> Path:
    """Return a configuration with a URDF of its own beside it."""
    folder.mkdir()
    document = yaml.safe_load((OWN / "target_leo.yaml").read_text())
    (folder / "robot.urdf").write_text(load("target_leo").urdf.read_text())
    document["robot"]["urdf"] = "robot.urdf"
    (folder / "own.yaml").write_text(yaml.safe_dump(document))
    return folder / "own.yaml"


def seeds(path: Path, out: Path) -> list[str]:
    """Return the options of the runs that a folder of results lacks."""
    ran: list[str] = []

    def row(_scenario, _work, _seeds, _store, _jobs):
        ran.extend(_work.keywords["options"])
        return []

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "rows", row)
        run_seeds("target_leo", range(1), 1, ["--fast"], out, {"config": path})
    return ran


def test_results_belong_to_the_content_of_a_configuration_not_to_its_path(tmp_path):
    path, out = own(tmp_path / "a"), tmp_path / "out"
    assert seeds(path, out) == ["--fast", "--config", str(path)]
    assert seeds(own(tmp_path / "b"), out)  # the same content elsewhere
    text = path.read_text()
    path.write_text(text.replace("torque_noise_nm: 0.05", "torque_noise_nm: 0.06"))
    assert path.read_text() != text
    with pytest.raises(ScenarioError, match="results of other settings"):
        seeds(path, out)
    path.write_text(text)
    urdf = path.with_name("robot.urdf")
    urdf.write_text(urdf.read_text() + "<!-- another robot -->")
    with pytest.raises(ScenarioError, match="results of other settings"):
        seeds(path, out)


@pytest.mark.parametrize("name", names())
def test_every_scenario_has_a_content_that_stays(name):
    assert content_of(load(name), {}) == content_of(load(name), {})


def test_a_changed_world_has_another_content():
    world = load("target_leo")
    assert content_of(replace(world, before_s=5.0), {}) != content_of(world, {})


def test_fresh_seeds_follow_from_commit_scenario_and_settings(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = []

    def flown(_scenario: str, numbers: range, *_: object) -> list[dict[str, Any]]:
        asked.append(numbers)
        return [outcome(400.0, 9.0)]

    monkeypatch.setattr(many, "run_seeds", flown)
    monkeypatch.setattr(provenance, "commit", lambda: "c691e082")
    coarse = ["--set", "sensors.joints.encoder_bits=16"]
    for words in ([], [], coarse):
        assert main(["seeds", "target_leo", "--fresh", "--count", "5", "--json", *words]) == 0
    assert asked[0] == asked[1] != asked[2]
    assert all(len(own) == 5 and own[0] >= provenance.FIRST_FRESH for own in asked)
    capsys.readouterr()
    with pytest.raises(SystemExit, match="2"):
        main(["seeds", "target_leo", "--fresh", "--first", "3"])
    assert "--first: not allowed with argument --fresh" in capsys.readouterr().err
