"""A motion known through noisy angles: rows by the motion, and honest covariances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline

from fsw.estimators.measurement.fused import predict
from fsw.estimators.methods.fused_batch import FUSED, solve_fused
from fsw.estimators.methods.motion_pass import motion_gradient, row_pass
from fsw.estimators.methods.prediction_pass import prediction_pass
from fsw.estimators.methods.system import Options, kernel_data
from fsw.estimators.samples import JointCurve, Noise, SampleSet, with_noise
from hil.world.spline import DEGREE
from tests.support.estimator_cases import N, make_problem, random_block
from tests.support.methods_cases import band, exact, nees, samples_of, truth
from tests.unit.fsw.estimators.test_methods_prediction import system_of

ANGLE_RAD = 3e-3
COEFFICIENTS = 21  # of the stored motions


@pytest.mark.parametrize("unknown", [("base",), ("target",), ("base", "target")])
def test_rows_are_those_of_the_gram(unknown):
    problem, system = system_of(unknown)
    x = truth(problem)
    data = kernel_data(samples_of(random_block(), 1))
    given = (system.arm, system.bodies(x), x, system.at, data, FUSED)
    rows, G = row_pass(*given)[0], prediction_pass(*given)
    scale = np.sqrt(np.outer(np.diag(G), np.diag(G)))
    assert np.all(np.abs(rows.T @ rows - G) <= 1e-9 * scale + 1e-12)


def test_gradient_by_the_motion_is_that_of_the_pinocchio_prediction():
    """By rates and accelerations the exact gains of the blocks; by angles its own differences."""
    problem, system = system_of(("base", "target"), biases=False)
    x, block = truth(problem), random_block()
    one = predict(block, x, problem)
    data = kernel_data(samples_of(block, 1))
    D = motion_gradient(system.arm, system.bodies(x), x, system.at, data, FUSED)[0]
    assert np.allclose(D[:, 1], one.D_qd[0], rtol=1e-6, atol=1e-6 * np.abs(one.D_qd[0]).max())
    scale = np.abs(one.D_qdd[0]).max()
    assert np.allclose(D[: N + 3, 2], one.D_qdd[0], rtol=1e-6, atol=1e-7 * scale)
    assert not D[N + 3 :, 2].any()
    h = 1e-4
    for j in range(N):
        step = np.zeros((1, N))
        step[0, j] = h
        ends = [predict(replace(block, q_rad=block.q_rad + s * step), x, problem) for s in (1, -1)]
        numeric = np.concatenate(
            [
                getattr(ends[0], name)[0] - getattr(ends[1], name)[0]
                for name in ("tau_nm", "f_m_s2", "w_rad_s")
            ]
        ) / (2 * h)
        assert np.allclose(D[:, 0, j], numeric, atol=1e-5 * np.abs(D[:, 0]).max())


def noisy(kind: str, seed: int) -> SampleSet:
    """Samples at 25 Hz whose motion is a spline fitted to angles with 3 mrad noise at 100 Hz."""
    rng = np.random.default_rng(seed)
    clean = exact(kind, 25.0)
    fine = exact(kind, 100.0)
    inner = np.linspace(0.0, 60.0, COEFFICIENTS - DEGREE + 1)
    knots = np.concatenate([np.zeros(DEGREE), inner, np.full(DEGREE, 60.0)])
    curve = BSpline(knots, np.eye(COEFFICIENTS), DEGREE)
    B = curve(fine.t_s)
    angles = fine.q + ANGLE_RAD * rng.standard_normal(fine.q.shape)
    coefficients = np.linalg.lstsq(B, angles, rcond=None)[0]
    basis = np.stack([curve(clean.t_s), *(curve.derivative(k)(clean.t_s) for k in (1, 2))])
    covariance = ANGLE_RAD**2 * np.linalg.solve(B.T @ B, np.eye(COEFFICIENTS))
    noise = Noise.of(N, tau_nm=2e-3, w_rad_s=2e-3, a_m_s2=2e-3)
    drawn = with_noise(clean, noise, rng)
    q, qd, qdd = basis @ coefficients
    return replace(
        drawn,
        q=q,
        qd=qd,
        qdd=qdd,
        curve=JointCurve(basis=basis, coefficients=coefficients, covariance=covariance),
    )


@pytest.mark.parametrize(("kind", "unknown"), [("target", ("target",)), ("base", ("base",))])
def test_covariance_is_honest_though_angles_are_noisy(kind, unknown):
    """NEES over ten seeds in its 99.9 % band; the motion taken as exact it is far outside."""
    problem = (
        make_problem(unknown, biases=False, target=None)
        if kind == "base"
        else make_problem(unknown, biases=False)
    )
    problem = replace(problem, p_BS_m=np.zeros(3))
    options = Options(body_prior=False, start=truth(problem))
    total, taken = 0.0, 0.0
    for seed in range(10):
        samples = noisy(kind, seed)
        result = solve_fused(samples, problem, options)
        assert result.status == "OK"
        total += nees(result, problem)
        if seed == 0:
            taken = nees(solve_fused(replace(samples, curve=None), problem, options), problem)
    low, high = band(10, 10)
    assert low < total < high
    assert taken > 3 * high / 10


def test_an_exact_curve_changes_nothing():
    """Angles of 1e-9 rad: the same estimate and covariance as of an exact motion."""
    problem = replace(make_problem(("target",), biases=False), p_BS_m=np.zeros(3))
    options = Options(body_prior=False, start=truth(problem))
    samples = noisy("target", 1)
    tight = replace(samples.curve, covariance=1e-14 * samples.curve.covariance)
    with_curve = solve_fused(replace(samples, curve=tight), problem, options)
    without = solve_fused(replace(samples, curve=None), problem, options)
    sigma = np.sqrt(np.diag(without.covariance))
    assert np.abs(with_curve.mean - without.mean).max() < 1e-2 * sigma.max()
    assert np.allclose(np.diag(with_curve.covariance), sigma**2, rtol=1e-3)


def test_a_part_of_the_samples_takes_its_part_of_the_curve():
    samples = noisy("target", 0)
    part = samples.take(slice(10, 20))
    assert part.curve is not None
    assert np.allclose(part.curve.basis[0] @ part.curve.coefficients, part.q)
