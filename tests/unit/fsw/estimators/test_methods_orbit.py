"""Gravity gradient in the compiled passes: Pinocchio's rows and the other engine's truth."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from fsw.estimators.measurement.fused import predict
from fsw.estimators.measurement.mrnea import mrnea_rows
from fsw.estimators.methods.energy_pass import energy_pass
from fsw.estimators.methods.fused_batch import solve_fused
from fsw.estimators.methods.layout import Channels
from fsw.estimators.methods.momentum import GYRO, solve_momentum
from fsw.estimators.methods.mrnea_batch import solve_mrnea
from fsw.estimators.methods.prediction_pass import prediction_pass, residual_pass
from fsw.estimators.methods.rda import solve_rda
from fsw.estimators.methods.regression_pass import OLS, regression_pass
from fsw.estimators.methods.system import Options, build_system, kernel_data
from fsw.estimators.samples import Noise, SampleSet
from tests.support.estimator_cases import N, make_problem, random_block
from tests.support.methods_cases import samples_of, truth
from tests.unit.fsw.estimators.test_external_moments import RATE, START_S, STOP_S, disturbed, orbit

BOUND = 1e-9
STRONG = 1e5  # times Earth's gradient, so that every part of it is seen
UNKNOWN = [("base",), ("target",), ("base", "target")]
MEASURED = Channels(torque=True, accelerometer=True, gyro=False, velocity=False, measured_rate=True)
SOLVERS = {
    "mrnea": solve_mrnea,
    "rda": solve_rda,
    "cm": solve_momentum,
    "fused": solve_fused,
}


def strong_problem(unknown, **options):
    field = replace(orbit(), gradient_1_s2=STRONG * RATE**2)
    problem = replace(make_problem(unknown, **options), p_BS_m=np.zeros(3), orbit=field)
    return problem, build_system(problem, Options())


def assert_gram(G, rows):
    wanted = rows.T @ rows
    scale = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
    assert np.all(np.abs(G - wanted) <= BOUND * scale + 1e-12)


@pytest.mark.parametrize("unknown", UNKNOWN)
def test_torque_and_acceleration_are_those_of_the_pinocchio_prediction(unknown):
    problem, system = strong_problem(unknown)
    x, block = truth(problem), random_block()
    one = predict(block, x, problem, "measured")
    r = np.concatenate([block.tau_nm[0] - one.tau_nm[0], block.f_NS_B_m_s2[0] - one.f_m_s2[0]])
    rows = np.column_stack([np.concatenate([one.J_tau[0], one.J_f[0]]), r])
    data = kernel_data(samples_of(block, 1), problem.orbit)._replace(s_w=np.zeros(3))
    k = [*range(problem.bodies.stop), -1]
    G = prediction_pass(system.arm, system.bodies(x), x, system.at, data, MEASURED)
    assert_gram(G[np.ix_(k, k)], rows[:, k])
    bare = prediction_pass(
        system.arm, system.bodies(x), x, system.at, data._replace(field=np.zeros((0, 3))), MEASURED
    )
    assert abs(bare[-1, -1] / G[-1, -1] - 1.0) > 1e-3  # the field is seen


@pytest.mark.parametrize("unknown", UNKNOWN)
def test_regression_rows_are_those_of_the_blocks(unknown):
    problem, system = strong_problem(unknown, biases=False)
    x, block = truth(problem), random_block()
    rows = mrnea_rows(block, x, problem, "ols")
    size = np.sqrt(np.mean(np.einsum("nii->ni", block.cov_tau)))
    own = size * np.column_stack([rows.A, rows.b])[: 6 + N]
    data = kernel_data(samples_of(block, 1), problem.orbit)
    sums = regression_pass(
        system.arm, system.bodies(x), x, system.at, data, problem.wrench_sigma, OLS, False
    )
    assert_gram(sums.gram, own)


@pytest.mark.parametrize("unknown", UNKNOWN)
def test_gradient_of_the_momentum_gained_agrees_with_finite_differences(unknown):
    problem, system = strong_problem(unknown, biases=False)
    x = truth(problem)
    data = kernel_data(samples_of(random_block(), 3, 5.0), problem.orbit)

    def gram(at):
        return prediction_pass(system.arm, system.bodies(at), at, system.at, data, GYRO)

    gradient = -2.0 * gram(x)[:-1, -1]
    numeric = np.empty_like(gradient)
    for i in range(len(x)):
        step = 1e-4 * max(1.0, abs(x[i])) * np.eye(len(x))[i]
        numeric[i] = (gram(x + step)[-1, -1] - gram(x - step)[-1, -1]) / (2 * step[i])
    assert numeric == pytest.approx(gradient, rel=1e-5, abs=1e-6 * np.abs(gradient).max())


@pytest.mark.parametrize("unknown", UNKNOWN)
def test_power_of_the_field_is_that_of_the_blocks(unknown):
    """In the balance of CE, whose effect in low orbit is below the quadrature of its work."""
    problem, system = strong_problem(unknown, biases=False)
    x, block = truth(problem), random_block()
    model, pi = problem.model, problem.pi(x)
    model.set_parameters(pi)
    G = problem.orbit.field(block, problem.window_s)[0]
    q, qd = block.q_rad[0], block.qd_rad_s[0]
    H = model.mass_matrix(q)
    nu = np.concatenate([-np.linalg.solve(H[:6, :6], H[:6, 6:] @ qd), qd])
    by_pi = nu @ model.field_regressor(q, G)
    field = kernel_data(samples_of(block, 1), problem.orbit).field
    found = energy_pass(system.arm, system.bodies(x), len(x), system.at, q[None], qd[None], field)
    assert found.P[0] == pytest.approx(by_pi @ pi, rel=BOUND)
    wanted = by_pi @ problem.U
    assert found.J_P[0, problem.bodies] == pytest.approx(
        wanted, rel=BOUND, abs=BOUND * np.abs(wanted).max()
    )


@lru_cache(maxsize=1)
def orbital_samples() -> SampleSet:
    """Return exact samples at 5 Hz of the motion with the field acting body by body."""
    t = np.arange(START_S, STOP_S, 0.2)
    s = disturbed("gradient").at(t)
    problem = make_problem(("base", "target"))
    whole = [problem.model.composite(q) @ problem.pi(truth(problem)) for q in s.q]
    zenith = kernel_data(_bare(t, s, s.a_NB_B), orbit()).field
    square = np.sum(zenith**2, axis=1)[:, None, None] * np.eye(3) / 3.0
    G = zenith[:, :, None] * zenith[:, None, :] - square
    felt = s.a_NB_B + np.array([g @ (pi[1:4] / pi[0]) for g, pi in zip(G, whole, strict=True)])
    return _bare(t, s, felt)


def _bare(t, s, acceleration) -> SampleSet:
    return SampleSet(
        t_s=t,
        q=s.q,
        qd=s.qd,
        qdd=s.qdd,
        tau=s.tau,
        w_NB_B=s.w_NB_B,
        wd_NB_B=s.wd_NB_B,
        a_NB_B=acceleration,
        R_NB=s.R_NB,
        noise=Noise.of(N, tau_nm=1e-6, w_rad_s=1e-9, a_m_s2=1e-8, wd_rad_s2=1e-9),
    )


def test_the_gyro_sees_the_momentum_gained_in_the_truth():
    problem = replace(make_problem(("base", "target"), biases=False), orbit=orbit())
    system, x, samples = build_system(problem, Options()), truth(problem), orbital_samples()
    left = [
        np.abs(
            residual_pass(
                system.arm, system.bodies(x), x, system.at, kernel_data(samples, field), GYRO
            )
        ).max()
        for field in (None, orbit())
    ]
    assert left[0] * 1e-9 > 2e-5  # rad/s: the effect is there
    assert left[1] <= 0.01 * left[0]


@pytest.mark.parametrize("method", SOLVERS)
def test_every_method_identifies_the_target_in_an_orbit(method):
    """Exact data of the other engine: modelled, at most a tenth of the error is left."""
    plain = make_problem(("target",), biases=False)
    wanted, errors = truth(plain), []
    options = Options(start=0.99 * wanted, body_prior=False)
    for field in (None, orbit()):
        result = SOLVERS[method](orbital_samples(), replace(plain, orbit=field), options)
        errors.append(np.abs((result.mean - wanted) / np.abs(wanted).max()).max())
    assert result.status == "OK"
    assert errors[1] <= 0.1 * errors[0]
