"""Modes of the base in the measurement model: against MuJoCo, derivatives, gaps, priors."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from fsw.config import ModeConfig
from fsw.errors import EstimatorError
from fsw.estimators.batch.run import run_batch
from fsw.estimators.measurement.fused import predict
from fsw.estimators.measurement.impulse import Impulse
from fsw.estimators.measurement.row_functions import row_function, stack, usable_rows
from fsw.estimators.model.inertia import PARAMETERS, is_consistent
from fsw.estimators.model.modes import in_base, modal_inertia
from fsw.estimators.model.problem import Problem
from fsw.estimators.recursive.memory import Memory
from fsw.estimators.recursive.snapshot import from_impulse, to_impulse
from fsw.estimators.square_root import SquareRootInformation
from fsw.messages import Block, FloatArray
from tests.support.estimator_cases import BASE, TARGET, WINDOW_S, parameters, random_block
from tests.support.mode_cases import (
    PANEL,
    TANK,
    config_with_modes,
    mode_settings,
    problem_with_modes,
    true_blocks,
)
from tests.support.slopes import assert_state_slopes, predicted_fields


def two_blocks(seed: int = 1) -> tuple[Block, Block]:
    """Return neighbours whose nodes move at random, as slowly as an arm does within a window."""
    blocks = [random_block(k) for k in (seed, seed + 1)]
    blocks = [
        replace(block, qd_rad_s=0.1 * block.qd_rad_s, qdd_rad_s2=0.1 * block.qdd_rad_s2)
        for block in blocks
    ]
    step_ns = round(WINDOW_S * 1e9)
    return blocks[0], replace(blocks[1], t_ns=blocks[1].t_ns + step_ns)


def true_state(problem: Problem) -> FloatArray:
    x = problem.prior_mean.copy()
    for name, body in (("base", BASE), ("target", TARGET)):
        if name in problem.unknown:
            x[problem.body(name)] = parameters(body)
    return x


def test_the_panel_is_the_one_of_the_truth() -> None:
    """Modal inertia and share of the base's data, by the simulated panel's own formulas."""
    for part in (PANEL, TANK):
        mode = ModeConfig.model_validate(mode_settings(part))
        assert modal_inertia(mode) == pytest.approx(part.moved, rel=1e-12)
        np.testing.assert_allclose(in_base(mode), part.pi, rtol=1e-12, atol=1e-12)


def test_the_prediction_is_mujoco_s_over_a_minute() -> None:
    """40 windows of arm, target, panel and tank; at zero momentum, from rest."""
    problem = problem_with_modes()
    x, before = true_state(problem), None
    for block in true_blocks(40):
        at = predict(block, x, problem, before=before)
        before = at.after
        np.testing.assert_allclose(at.tau_nm, block.tau_nm, atol=2e-4)
        np.testing.assert_allclose(at.f_m_s2, block.f_NS_B_m_s2, atol=2e-6)
        np.testing.assert_allclose(at.w_rad_s, block.w_NB_B_rad_s, atol=2e-7)
    assert before is not None
    assert abs(before.modes[0]) > 1e-4  # the panel swings


@pytest.mark.parametrize("rate", ["momentum", "measured"])
def test_jacobians_are_the_derivatives(rate: Any) -> None:
    """Over two windows, so that what the first leaves behind is in them."""
    problem = problem_with_modes(("base", "target"), doubt=True, momentum_sigma_nms=1.0)
    x, (first, second) = true_state(problem), two_blocks()
    x[20:] = 0.01 * np.random.default_rng(0).normal(size=len(x) - 20)

    def last(x: FloatArray) -> Any:
        return predict(second, x, problem, rate, predict(first, x, problem, rate).after)

    assert_state_slopes(
        last,
        x,
        lambda k: 1e-4 * max(1.0, abs(x[k])),
        rtol=2e-4,
        of_slope=1e-5,
        rounding=1e-10,
        fields=predicted_fields(rate),
    )


def information(problem: Problem, blocks: Any, x: FloatArray) -> SquareRootInformation:
    prior = SquareRootInformation.from_prior(problem.prior_mean, problem.prior_covariance)
    for rows in stack(row_function("fused", "eiv", problem), blocks, x):
        prior = prior.update(rows.A, rows.b + rows.A @ x)
    return prior


def test_noise_free_data_of_wrong_modes_give_the_true_ones_back() -> None:
    """Frequency 8 % off, damping 20 %, mass 10 %: a batch finds them, and the target."""
    wrong = mode_settings(PANEL, mass_kg=PANEL.mass_kg / 1.1)
    wrong |= {"inertia_kg_m2": [value / 1.1 for value in PANEL.inertia_kg_m2]}
    wrong |= {"frequency_hz": PANEL.frequency_hz * 0.92, "damping_ratio": 0.8 * 0.02}
    config = config_with_modes(("target",), [wrong, mode_settings(TANK)])
    result = run_batch(config, true_blocks(60), "fused", ("target",))
    assert result["status"] != "NOT_CONVERGED"  # residuals without noise are alike: no OK
    state = dict(zip(result["names"], result["mean"], strict=True))
    sigma = dict(zip(result["names"], np.sqrt(np.diag(result["covariance"])), strict=True))
    for name, true in (
        ("mode_mass.panel", 0.1),
        ("mode_frequency.panel", -np.log(0.92)),
        ("mode_damping.panel", -np.log(0.8)),
    ):  # no noise in the data; what is left is the prior's pull
        assert abs(state[name] - true) < 1.0 * sigma[name]
    assert sigma["mode_frequency.panel"] < 0.02
    assert result["estimate"]["target"]["mass_kg"] == pytest.approx(400.0, abs=2e-3)


def test_what_is_not_excited_stays_at_its_prior() -> None:
    """The arm at rest: frequency, damping and mass keep mean and sigma of the prior."""
    problem = problem_with_modes()
    x, block = true_state(problem), true_blocks(40)[0]
    still = replace(block, qd_rad_s=0.0 * block.qd_rad_s, qdd_rad_s2=0.0 * block.qdd_rad_s2)
    step_ns = round(WINDOW_S * 1e9)
    blocks = [replace(still, index=k, t_ns=still.t_ns + k * step_ns) for k in range(5)]
    covariance = information(problem, blocks, x).covariance()
    for states in (
        problem.at("mode_mass"),
        problem.at("mode_frequency"),
        problem.at("mode_damping"),
    ):
        np.testing.assert_allclose(
            np.diag(covariance)[states], np.diag(problem.prior_covariance)[states], rtol=1e-3
        )


def test_a_base_is_linearised_as_more_than_its_modes() -> None:
    """A base lighter than its liquid has no inertia less it; every window would fail there."""
    problem, block = problem_with_modes(("base",)), true_blocks(40)[0]
    rows = row_function("fused", "eiv", problem)
    light = true_state(problem)
    light[problem.body("base")] *= 0.9 * (PANEL.mass_kg + TANK.mass_kg) / BASE.mass_kg
    light[problem.at("mode_frequency")] = 2.0
    at = problem.consistent(light, lambda: problem.prior_covariance)
    assert problem.modes is not None
    assert is_consistent(at[problem.body("base")])
    assert is_consistent(problem.modes.released.pi(at)[:PARAMETERS])
    sigma = np.sqrt(np.diag(problem.prior_covariance)[problem.at("mode_frequency")])
    assert np.all(np.abs(at[problem.at("mode_frequency")]) <= 3.0 * sigma)
    assert usable_rows(rows, [block], at, None)
    heavy = true_state(problem)
    assert problem.consistent(heavy, lambda: problem.prior_covariance) is heavy


def test_after_a_gap_the_windows_together_know_the_modes_as_well_as_before_and_no_better() -> None:
    """One window alone, and all after the gap, must say less of the start than of no gap."""
    problem, blocks = problem_with_modes(), true_blocks(60)
    x = true_state(problem)
    k = problem.at("mode_frequency")
    whole = information(problem, blocks, x).covariance()[k, k]
    torn = information(problem, [*blocks[:30], *blocks[35:]], x).covariance()[k, k]
    short = information(problem, blocks[:30], x).covariance()[k, k]
    assert whole[0, 0] < torn[0, 0] <= short[0, 0] * (1.0 + 1e-9)


def test_a_gated_block_carries_the_modes_on_and_says_nothing() -> None:
    problem, blocks = problem_with_modes(), true_blocks(40)
    x, rows = true_state(problem), row_function("fused", "eiv", problem)
    prior = SquareRootInformation.from_prior(problem.prior_mean, problem.prior_covariance)
    memory, counted = Memory(prior, 2), 0
    for number, block in enumerate(blocks[:6]):
        made = rows(block, x, memory.gained)
        memory.add(block, made, x, keep=True, weight=float(number != 2))
        counted += len(made.b) * (number != 2)
        assert (made.edge == 0) == (number in (0, 3))  # the motion is parted after it
        assert memory.gained is not None
        assert not memory.gained.doubt.any()
    assert len(memory.rows_at(x)[0]) == 2
    seen = information(problem, blocks[:2], x)
    assert memory.rows == counted
    assert np.linalg.slogdet(memory.information.R)[1] > np.linalg.slogdet(seen.R)[1]


def test_after_a_pass_the_modes_are_carried_from_its_point_though_blocks_came_meanwhile() -> None:
    """As by one sweep over all blocks at the pass's point, to the last bit."""
    problem, blocks = problem_with_modes(), true_blocks(40)
    rows = row_function("fused", "eiv", problem)
    x = true_state(problem)
    first = x.copy()
    first[problem.at("mode_frequency")] += 0.1
    prior = SquareRootInformation.from_prior(problem.prior_mean, problem.prior_covariance)
    memory = Memory(prior, 40)
    for block in blocks[:6]:
        memory.add(block, rows(block, first, memory.gained), first, keep=True)
    memory.begin(x)
    for block in blocks[6:9]:
        assert not memory.advance(partial(usable_rows, rows))
        memory.add(block, rows(block, x, memory.gained), x, keep=True)
    while not memory.advance(partial(usable_rows, rows), 4):
        pass
    before, swept = None, prior
    for block in blocks[:9]:
        made = rows(block, x, before)
        before, swept = made.after, swept.update(made.A, made.b + made.A @ x)
    assert memory.gained is not None
    assert before is not None
    np.testing.assert_array_equal(memory.gained.modes, before.modes)
    np.testing.assert_array_equal(memory.gained.J_modes, before.J_modes)
    np.testing.assert_allclose(memory.information.mean(), swept.mean(), rtol=0, atol=1e-6)


def test_the_carried_modes_survive_a_snapshot() -> None:
    problem, block = problem_with_modes(), true_blocks(40)[3]
    after = predict(block, true_state(problem), problem).after
    again = to_impulse(from_impulse(after))
    assert isinstance(again, Impulse)
    assert after is not None
    for name in ("modes", "J_modes", "doubt", "L_Nms"):
        np.testing.assert_array_equal(getattr(again, name), getattr(after, name))


def test_a_stack_is_its_blocks_one_after_another() -> None:
    problem, blocks = problem_with_modes(), true_blocks(40)[:3]
    x, rows = true_state(problem), row_function("fused", "eiv", problem)
    before = None
    for block, together in zip(blocks, stack(rows, blocks, x), strict=True):
        alone = rows(block, x, before)
        before = alone.after
        np.testing.assert_array_equal(alone.A, together.A)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"axes_B": [[1, 0, 0], [0, 1, 0]]}, "2 axes; a panel has one"),
        ({"axes_B": [[1, 1, 0]]}, r"\[\[1.0, 1.0, 0.0\]\]; must each have length 1"),
        ({"amplitude_rad": None}, "amplitude_rad: missing"),
        ({"amplitude_m": 0.1}, "amplitude_m: 0.1 is not of kind: panel, amplitude_rad is"),
        ({"inertia_kg_m2": None}, "inertia_kg_m2: missing"),
        ({"inertia_kg_m2": [1, 0, 0, 1, 0, 9]}, "of no body"),
    ],
)
def test_a_wrong_mode_is_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        ModeConfig.model_validate(mode_settings(PANEL, **change))


def test_methods_without_modes_are_refused() -> None:
    with pytest.raises(ValueError, match="must be fused, rda or cm"):
        config_with_modes(method="mrnea")
    with pytest.raises(EstimatorError, match="modes"):
        run_batch(config_with_modes(), true_blocks(40)[:3], "ce", ("target",))
