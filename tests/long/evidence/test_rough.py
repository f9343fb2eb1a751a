"""The acceptance in a rough world, in its short form: one seed of the command's own code."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from evidence.methods.cases import scenario_of
from evidence.rough.case import LINKS_OFF, Case, _rms, _sized, drawn_body, made, work
from evidence.rough.command import STUDY
from fsw.estimators.model.calibration import spread_root
from fsw.estimators.model.robot import RobotModel
from fsw.estimators.recursive.online import build_online
from hil.judge.outcome import worst
from hil.world.inertia import pi_of


@pytest.mark.parametrize("unknown", ["target", "both"])
def test_declared_it_is_valid_and_honest(unknown: str) -> None:
    (row,) = work(Case(unknown, "declared", 0)).values()
    assert row["valid"], row["reason"]
    assert row["wrong"] == 0
    assert row["nees"] < chi2.ppf(0.999, row["dof"])


def test_undeclared_it_is_never_valid_and_wrong_and_rows_are_kept(tmp_path: Path) -> None:
    (summary,) = STUDY.lines([("target", "undeclared")], [0], 1, tmp_path)
    assert summary["wrong"] == 0
    assert summary["passed"]
    assert summary["valid"] == 0
    (line,) = (tmp_path / "results.jsonl").read_text(encoding="utf-8").splitlines()
    assert json.loads(line)[0] == "target undeclared 0"
    assert STUDY.lines([("target", "undeclared")], [0], 1, tmp_path) == [summary]


def test_the_flight_side_knows_nothing_of_the_rough_world(tmp_path: Path) -> None:
    """Its links and base are off, its declared noise is that of white samples."""
    config, blocks = made(Case("target", "declared", 1), tmp_path, 3)
    assert len(blocks) == 3
    assert config.robot.links_sigma_ratio == pytest.approx(0.0321, abs=1e-4)
    off = abs(config.bodies["base"].mass_kg / 1000.0 - 1.0)
    assert 0.01 <= off <= 0.05


def test_wrong_bodies_are_draws_from_what_is_declared_of_them() -> None:
    """Their distance from the truth in the declared covariance is that of ten unit variances."""
    rng, count = np.random.default_rng(5), 2000
    report = np.array([4.8, 0.02, -0.05, 0.25, 0.11, 0.004, -0.002, 0.10, 0.003, 0.02])
    root = spread_root(pi_of(report), _rms(*LINKS_OFF))
    drawn = np.array([drawn_body(report, off, rng) for off in _sized(rng, *LINKS_OFF, count)])
    off = np.array([pi_of(body) for body in drawn]) - pi_of(report)
    unit = np.linalg.solve(root, off.T)
    bound = 4.0 * np.sqrt(2.0 / count)  # of a variance; a mass of even size scatters less
    assert np.max(np.abs(np.mean(unit**2, axis=1) - 1.0)) < bound
    share = np.abs(drawn[:, 0] / report[0] - 1.0)
    assert share.min() >= LINKS_OFF[0]
    assert share.max() <= LINKS_OFF[1]


def test_a_base_known_to_a_sixth_is_not_confidently_light(tmp_path: Path) -> None:
    """Seed 5: 616 kg of 1000 after twelve seconds, beyond 3.5 sigma of the covariance."""
    config, blocks = made(Case("base", "defaults", 5), tmp_path, 30)
    robot = RobotModel(config.resolve(config.robot.urdf), config.robot.tool_frame)
    online, truth = build_online(config, robot), scenario_of("base").truth
    told = [online.push(block) for block in blocks][24:]  # enough windows, settled or not
    light_kg = [truth["base"][0] - estimate.mean[0] for estimate in told]
    sigma_kg = [np.sqrt(estimate.covariance[0, 0]) for estimate in told]
    assert np.max(np.divide(light_kg, sigma_kg)) > 3.5
    assert max(worst(estimate.bodies, truth) for estimate in told) < 3.5
