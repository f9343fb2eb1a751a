"""What noisy accelerations add to MRNEA's normal equations, against Pinocchio's regressor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fsw.estimators.methods.regression_pass import EIV, OLS, WLS, regression_pass
from fsw.estimators.methods.system import Options, build_system, kernel_data
from fsw.estimators.samples import Noise
from tests.support.estimator_cases import N, make_problem
from tests.support.methods_cases import exact, truth

NOISE = Noise.of(N, tau_nm=0.05, qdd_rad_s2=2e-3, wd_rad_s2=1e-2, a_m_s2=5e-3)  # rates exact
SAMPLES = 5


@pytest.mark.parametrize("unknown", [("base",), ("target",), ("base", "target")])
@pytest.mark.parametrize("mode", [OLS, WLS, EIV])
def test_inflation_is_the_sum_over_the_noise_of_pinocchio_regressors(unknown, mode):
    problem = make_problem(unknown, biases=False)
    system = build_system(problem, Options())
    samples = replace(exact("target").take(slice(100, 100 + SAMPLES)), noise=NOISE)
    x = truth(problem)
    found = regression_pass(
        system.arm, system.bodies(x), x, system.at, kernel_data(samples), problem.wrench_sigma,
        mode, True,
    )  # fmt: skip
    inflation, shrinkage = expected(problem, samples, x, mode)
    # of EIV a difference is left: rounding is that of what is subtracted
    size = np.sqrt(np.diag(expected(problem, samples, x, WLS)[0] if mode == EIV else inflation))
    assert np.all(np.abs(found.inflation - inflation) <= 1e-9 * np.outer(size, size))
    if mode != EIV:
        assert np.all(np.abs(found.shrinkage - shrinkage) <= 1e-9 * np.abs(shrinkage).max())


def expected(problem, samples, x, mode):
    model, m, p = problem.model, 6 + N, len(x)
    model.set_parameters(problem.pi(x))
    P0 = np.diag(np.concatenate([NOISE.a_m_s2, NOISE.wd_rad_s2, NOISE.qdd_rad_s2]) ** 2)
    inflation, shrinkage = np.zeros((p, p)), np.zeros(p)
    for q in samples.q:
        H = model.mass_matrix(q).copy()
        unit = [model.regressor(q, np.zeros(3), np.zeros(N), a) @ problem.U for a in np.eye(m)]
        Y = np.array(unit)  # (m accelerations, m rows, p)
        outputs = np.concatenate([problem.wrench_sigma, NOISE.tau_nm]) ** 2
        W = np.linalg.solve(H @ P0 @ H + np.diag(outputs), np.eye(m))
        if mode == OLS:
            W = np.eye(m) / NOISE.tau_nm[0] ** 2
        P = P0 - P0 @ H @ W @ H @ P0 if mode == EIV else P0
        inflation += np.einsum("kip,kl,ij,ljq->pq", Y, P, W, Y, optimize=True)
        shrinkage += np.einsum("kip,ik->p", Y, W @ H @ P0, optimize=True)
    return inflation, shrinkage
