"""A servicer's effects from samples: consistent, efficient, and seen where something is wrong."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from evidence.effects.bound import information_of
from evidence.effects.case import Case, work
from evidence.effects.command import LIMIT, STUDY, summary
from evidence.effects.samples import exact, noisy, rate_hz, truth
from evidence.methods.flight_side import write_config, write_true_config
from evidence.methods.recursion import recursion_row
from evidence.methods.sensed import condition
from hil.judge import bound, chi_square
from hil.judge.floating import FloatingRobot
from hil.run.flight_sensors import bound_sensors
from hil.world.inertia import pi_jacobian, pi_of
from hil.world.scenario import load

RARE = 1e-3  # of right code that such few seeds would call wrong


@cache
def row_of(name, seed):
    return work(Case(name, seed))[f"{name} {seed}"]


@pytest.mark.parametrize(
    ("name", "seeds"), [("wheels_leo", 3), ("mev", 1), ("panel_leo", 2), ("base_slosh", 1)]
)
def test_few_seeds_of_an_effect_are_in_their_band_and_near_the_bound(name, seeds):
    rows = [row_of(name, seed) for seed in range(seeds)]
    found = summary(rows, RARE)
    low, high = found["band"]
    assert found["valid"] == seeds
    assert found["wrong"] == 0
    assert low <= found["mean_nees"] <= high
    dof = found["dof"] * seeds
    assert found["error_over_bound"] <= LIMIT * (chi_square.ends(dof, RARE)[1] / dof) ** 0.5


def test_wheels_read_with_the_wrong_sign_are_no_valid_estimate(tmp_path):
    scenario = load("wheels_leo")
    config = write_config(scenario, 0, tmp_path)
    samples = noisy(exact("wheels_leo", config), config, 0)
    turned = [replace(own, values=-own.values) for own in samples.wheels]
    wrong = replace(samples, wheels=tuple(turned))
    row, _ = recursion_row(config, condition(wrong, config, rate_hz(scenario)), scenario.truth)
    assert (row["valid"], row["reason"]) == (False, "MODEL_MISMATCH")


def test_the_bound_is_that_of_the_bench_where_there_is_no_effect(tmp_path):
    """Raw samples at their native rates by the bench's own model, which has exact encoders."""
    scenario = load("target_leo")
    history, duration_s = truth("target_leo")
    config = write_true_config(scenario, tmp_path)
    sharp = [joint.model_copy(update={"position_noise_rad": 1e-9}) for joint in config.joints]
    own = information_of("target_leo", config.model_copy(update={"joints": sharp}))
    pis = {body: pi_of(report) for body, report in scenario.truth.items()}
    robot = FloatingRobot(scenario.urdf, scenario.tool_frame, pis, scenario.unknown)
    state = history.at(np.arange(0.0, duration_s, 0.05))
    motion = (state.q, state.qd, state.qdd)
    sensors, x = bound_sensors(scenario, robot.n), pis["target"]
    J = pi_jacobian(scenario.truth["target"])
    raw = J.T @ bound.information(robot, sensors, x, motion, 20.0) @ J
    sigmas = [np.sqrt(np.diag(np.linalg.inv(F))) for F in (own, raw)]
    np.testing.assert_allclose(*sigmas, rtol=0.05)


def test_a_seed_is_run_once_and_its_row_depends_on_nothing_else(tmp_path):
    row = row_of("wheels_leo", 0)
    (first,) = STUDY.lines([("wheels_leo",)], [0], 1, tmp_path)
    journal = (tmp_path / "results.jsonl").read_bytes()
    (again,) = STUDY.lines([("wheels_leo",)], [0], 1, tmp_path)
    assert first == again
    assert (tmp_path / "results.jsonl").read_bytes() == journal
    assert first["mean_nees"] == row["nees"]
