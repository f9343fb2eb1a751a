"""The batch methods on sample sets: truth from exact data, consistency, starts, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fsw.estimators.methods.energy import solve_energy
from fsw.estimators.methods.fused_batch import solve_fused
from fsw.estimators.methods.momentum import solve_momentum
from fsw.estimators.methods.mrnea_batch import solve_mrnea
from fsw.estimators.methods.rda import solve_rda
from fsw.estimators.methods.result import directions
from fsw.estimators.methods.system import Options, build_system
from fsw.estimators.model.inertia import is_consistent
from fsw.estimators.samples import Noise, with_noise
from tests.support.estimator_cases import N, make_problem
from tests.support.methods_cases import FINE, FULL, PLAIN, band, exact, nees, start, truth

SOLVERS = {
    "rda": solve_rda,
    "cm": solve_momentum,
    "fused": solve_fused,
    "ce": solve_energy,
    "mrnea": solve_mrnea,
}
CASES = [("target",), ("base",), ("base", "target")]
SEEDS = 20


def problem_of(unknown):
    if unknown == ("base",):
        return make_problem(unknown, biases=False, target=None), exact("base")
    return make_problem(unknown, biases=False), exact("target")


@pytest.mark.parametrize("unknown", CASES)
@pytest.mark.parametrize("method", ["rda", "cm", "fused", "mrnea"])
def test_exact_data_give_the_truth_from_far_off(method, unknown):
    problem, samples = problem_of(unknown)
    result = SOLVERS[method](samples, problem, Options(start=start(problem, 1), body_prior=False))
    assert result.status == "OK"
    assert result.mean == pytest.approx(truth(problem), rel=1e-4, abs=1e-2)


def test_energy_gives_the_truth_of_a_target_from_exact_data():
    problem, samples = problem_of(("target",))
    result = solve_energy(samples, problem, Options(start=start(problem, 1), body_prior=False))
    assert result.status == "OK"
    assert result.mean == pytest.approx(truth(problem), rel=1e-3, abs=0.1)


@pytest.mark.parametrize(
    ("method", "unknown"),
    [
        ("rda", ("target",)),
        ("fused", ("target",)),
        ("mrnea", ("target",)),
        ("fused", ("base",)),
        ("fused", ("base", "target")),
        ("mrnea", ("base", "target")),
    ],
)
def test_errors_agree_with_the_covariance(method, unknown):
    problem, samples = problem_of(unknown)
    options = Options(start=truth(problem), body_prior=False)
    total = 0.0
    for seed in range(SEEDS):
        noisy = with_noise(samples, FULL, np.random.default_rng(seed))
        result = SOLVERS[method](noisy, problem, options)
        assert result.status == "OK"
        total += nees(result, problem)
    low, high = band(len(problem.names), SEEDS)
    assert low <= total <= high


@pytest.mark.parametrize(
    ("method", "unknown"),
    [("rda", ("base",)), ("rda", ("base", "target")), ("mrnea", ("base",))],
)
def test_errors_agree_with_the_covariance_of_a_weakly_known_base(method, unknown):
    """The base's mass is known to about a tenth: RDA's covariance comes by way of the mobility."""
    problem, samples = problem_of(unknown)
    options = Options(start=truth(problem), body_prior=False)
    total = 0.0
    for seed in range(SEEDS):
        noisy = with_noise(samples, FINE, np.random.default_rng(seed))
        result = SOLVERS[method](noisy, problem, options)
        assert result.status == "OK"
        total += nees(result, problem)
    low, high = band(len(problem.names), SEEDS)
    assert low <= total <= high


@pytest.mark.parametrize("method", ["rda", "mrnea"])
def test_squared_rate_noise_feigns_no_inertia(method):
    """With a gyro ten times as noisy the mean of w x I w is the data's own, not the bodies'."""
    problem, samples = problem_of(("target",))
    noise = replace(FULL, w_rad_s=10.0 * FULL.w_rad_s)
    options = Options(start=truth(problem), body_prior=False)
    total, seeds = 0.0, 12
    for seed in range(seeds):
        noisy = with_noise(samples, noise, np.random.default_rng(seed))
        result = SOLVERS[method](noisy, problem, options)
        assert result.status == "OK"
        total += nees(result, problem)
    low, high = band(len(problem.names), seeds)
    assert low <= total <= high


def test_least_squares_shrinks_and_says_so():
    problem, samples = problem_of(("target",))
    noisy = with_noise(samples, FULL, np.random.default_rng(1))
    result = solve_mrnea(noisy, problem, Options(weighting="ols", body_prior=False))
    assert result.mean[0] < 300.0  # of 400 kg
    assert result.bias_note
    assert result.bodies["target"].mass_sigma_kg > 100.0


def test_compensation_takes_the_bias_away():
    problem, samples = problem_of(("base",))
    options = Options(weighting="compensated", body_prior=False)
    masses = []
    for seed in range(10):
        noisy = with_noise(samples, PLAIN, np.random.default_rng(seed))
        masses.append(solve_mrnea(noisy, problem, options).mean[0])
    spread = np.std(masses) / np.sqrt(10)
    assert abs(np.mean(masses) - 1000.0) < 4.0 * spread
    plain = solve_mrnea(noisy, problem, replace(options, weighting="wls"))
    assert plain.mean[0] < 600.0


def test_an_arm_at_rest_is_refused():
    problem, samples = problem_of(("base", "target"))
    still = replace(
        samples.take(slice(0, 200)),
        qd=np.zeros((200, N)),
        qdd=np.zeros((200, N)),
        q=np.tile(samples.q[0], (200, 1)),
        tau=np.zeros((200, N)),
        w_NB_B=np.zeros((200, 3)),
        wd_NB_B=np.zeros((200, 3)),
        a_NB_B=np.zeros((200, 3)),
        noise=FULL,
    )
    for method in ("rda", "fused", "mrnea", "cm"):
        result = SOLVERS[method](still, problem, Options(body_prior=False))
        assert result.status == "INSUFFICIENT_EXCITATION", method
        assert np.all(np.isfinite(result.covariance))
        assert all(is_consistent_body(b) for b in result.bodies.values())


def is_consistent_body(body) -> bool:
    from fsw.estimators.model.inertia import to_parameters

    return is_consistent(to_parameters(body.mass_kg, body.com_m, body.inertia_kg_m2))


def test_few_iterations_are_reported_as_not_converged():
    problem, samples = problem_of(("base", "target"))
    noisy = with_noise(samples, FULL, np.random.default_rng(1))
    options = Options(start=start(problem, 1), body_prior=False, max_iterations=2)
    assert solve_rda(noisy, problem, options).status == "NOT_CONVERGED"


def test_directions_rank_what_the_data_know():
    problem, samples = problem_of(("base", "target"))
    noisy = with_noise(samples, FULL, np.random.default_rng(1))
    result = solve_momentum(noisy, problem, Options())
    found = directions(result, build_system(problem, Options()))
    assert found[0].known_by == "data"
    # the scale of both bodies together: four orders less than the best known combination
    assert found[-1].information_ratio < 1e-4 * found[0].information_ratio
    assert result.bias_note  # widened along that scale
    assert np.all(result.efficiency <= 1.0 + 1e-9)
    assert result.efficiency.min() < 0.9


def test_verdict_tells_the_time_still_needed():
    problem, samples = problem_of(("base",))
    noisy = with_noise(samples, FULL, np.random.default_rng(1))
    result = solve_fused(noisy, problem, Options(wanted_accuracy=0.01))
    body = result.bodies["base"]
    more = result.duration_s * ((body.mass_sigma_kg / body.mass_kg / 0.01) ** 2 - 1.0)
    assert f"needs {more:.0f} s more" in result.verdict


def test_nuisances_are_estimated_along():
    problem = make_problem(("target",))
    samples = exact("target")
    offsets = np.linspace(-0.2, 0.2, N)
    shifted = replace(
        samples,
        tau=samples.tau + offsets,
        w_NB_B=samples.w_NB_B + 2e-5,
        a_NB_B=samples.a_NB_B + 0.01,
    )
    noise = Noise.of(N, tau_nm=0.01, w_rad_s=1e-6, wd_rad_s2=1e-6, a_m_s2=1e-5)
    for solve in (solve_fused, solve_mrnea):
        result = solve(replace(shifted, noise=noise), problem, Options())
        assert result.mean[problem.torque_offset] == pytest.approx(offsets, abs=1e-3)
        assert result.mean[problem.acc_bias] == pytest.approx(0.01, abs=1e-4)
        assert result.mean[problem.bodies] == pytest.approx(
            truth(problem)[problem.bodies], rel=1e-3, abs=0.1
        )


@pytest.mark.parametrize("method", ["cm", "ce"])
def test_sigma_covers_the_truth_where_the_likelihood_is_bent(method):
    """The linearised covariance of both bodies is at NEES/dof of 10 (CM) and more (CE) here."""
    problem, samples = problem_of(("base", "target"))
    noise = Noise.of(N, tau_nm=0.05, w_rad_s=1e-4)
    for seed in range(4):
        noisy = with_noise(samples, noise, np.random.default_rng(seed))
        options = Options(start=start(problem, seed), body_prior=False)
        result = SOLVERS[method](noisy, problem, options)
        assert result.status == "OK"
        assert "base" in result.bias_note
        assert nees(result, problem) < band(20, 1)[1]
        assert np.all(result.efficiency <= 1.0 + 1e-9)


@pytest.mark.slow
def test_rda_converges_from_99_of_100_starts():
    problem, samples = problem_of(("base", "target"))
    noise = Noise.of(N, tau_nm=0.05)
    noisy = with_noise(samples, noise, np.random.default_rng(0))
    best = solve_rda(noisy, problem, Options(start=truth(problem), body_prior=False))
    good = 0
    for seed in range(100):
        options = Options(start=start(problem, seed), body_prior=False)
        result = solve_rda(noisy, problem, options)
        good += result.status == "OK" and result.cost <= best.cost * (1 + 1e-6)
    assert good >= 99


@pytest.mark.parametrize("channel", ["q", "tau", "w_NB_B", "a_NB_B"])
def test_samples_that_are_not_finite_are_refused(channel):
    samples = exact("target").take(slice(0, 10))
    values = getattr(samples, channel).copy()
    values[3, 1] = np.nan
    with pytest.raises(ValueError, match=f"{channel} holds 1 non-finite"):
        replace(samples, **{channel: values})
