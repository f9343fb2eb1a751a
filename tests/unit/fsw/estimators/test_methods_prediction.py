"""The compiled passes against the Pinocchio-based rows and finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fsw.estimators.measurement.fused import predict
from fsw.estimators.methods.fused_batch import FUSED
from fsw.estimators.methods.momentum import GYRO
from fsw.estimators.methods.prediction_pass import prediction_pass, residual_pass
from fsw.estimators.methods.rate_pass import known_pass, rate_pass
from fsw.estimators.methods.rda import RDA
from fsw.estimators.methods.system import Options, build_system, kernel_data
from fsw.estimators.samples import Noise
from tests.support.estimator_cases import N, make_problem, random_block
from tests.support.methods_cases import samples_of, truth

BOUND = 1e-9


def system_of(unknown, **options):
    problem = make_problem(unknown, **options)
    problem = replace(problem, p_BS_m=np.zeros(3))
    return problem, build_system(problem, Options())


@pytest.mark.parametrize("unknown", [("base",), ("target",), ("base", "target")])
def test_gram_is_that_of_the_pinocchio_prediction(unknown):
    problem, system = system_of(unknown, momentum_sigma_nms=1.0)
    x = truth(problem) + 0.01 * np.random.default_rng(3).normal(size=len(problem.names))
    block = random_block()
    one = predict(block, x, problem)
    J = np.concatenate([one.J_tau[0], one.J_f[0], one.J_w[0]])
    r = np.concatenate(
        [
            block.tau_nm[0] - one.tau_nm[0],
            block.f_NS_B_m_s2[0] - one.f_m_s2[0],
            block.w_NB_B_rad_s[0] - one.w_rad_s[0],
        ]
    )
    rows = np.column_stack([J, r])
    G = prediction_pass(
        system.arm, system.bodies(x), x, system.at, kernel_data(samples_of(block, 1)), FUSED
    )
    scale = np.sqrt(np.outer(np.diag(rows.T @ rows), np.diag(rows.T @ rows)))
    assert np.abs(G - rows.T @ rows).max() <= BOUND * scale.max()
    assert np.all(np.abs(G - rows.T @ rows) <= BOUND * scale + 1e-12)


@pytest.mark.parametrize("unknown", [("base",), ("target",), ("base", "target")])
@pytest.mark.parametrize("use", [RDA, FUSED])
def test_gradient_agrees_with_finite_differences_with_noisy_inputs(unknown, use):
    problem, system = system_of(unknown, biases=False)
    x = truth(problem)
    noise = Noise.of(N, tau_nm=0.05, qdd_rad_s2=1e-3, w_rad_s=1e-5, a_m_s2=1e-2)
    data = kernel_data(replace(samples_of(random_block(), 1), noise=noise))

    def gram(at: np.ndarray) -> np.ndarray:
        return prediction_pass(system.arm, system.bodies(at), at, system.at, data, use)

    gradient = -2.0 * gram(x)[:-1, -1]
    for i in range(len(x)):
        h = 1e-5 * max(1.0, abs(x[i]))
        step = h * np.eye(len(x))[i]
        numeric = (gram(x + step)[-1, -1] - gram(x - step)[-1, -1]) / (2 * h)
        # rate noise is smoothed to first order only, hence not 1e-9
        assert numeric == pytest.approx(gradient[i], rel=2e-2, abs=2e-3 * np.abs(gradient).max())


def test_compiled_residuals_are_those_of_the_gram():
    problem, system = system_of(("base", "target"), biases=False)
    x = truth(problem)
    data = kernel_data(samples_of(random_block(), 1))._replace(s_w=np.zeros(3))
    r = residual_pass(system.arm, system.bodies(x), x, system.at, data, RDA)
    G = prediction_pass(system.arm, system.bodies(x), x, system.at, data, RDA)
    assert float(np.sum(r**2)) == pytest.approx(G[-1, -1], rel=BOUND)


@pytest.mark.parametrize("unknown", [("base",), ("target",), ("base", "target")])
@pytest.mark.parametrize("use", [GYRO, GYRO._replace(velocity=True)])
def test_known_share_taken_out_leaves_the_gram_as_it_is(unknown, use):
    problem, system = system_of(
        unknown, momentum_sigma_nms=1.0, external_force_sigma_n=0.1, external_torque_sigma_nm=0.1
    )
    rng = np.random.default_rng(4)
    x = truth(problem) + 0.1 * rng.normal(size=len(problem.names))
    samples = replace(samples_of(random_block(), 4, 5.0), v_NB_B=rng.normal(size=(4, 3)))
    data = kernel_data(samples)._replace(s_w=np.array([0.1, 0.2, 0.3]), s_v=np.ones(3))
    whole = prediction_pass(system.arm, system.bodies(x), x, system.at, data, use)
    known = known_pass(system.arm, system.bodies(np.zeros_like(x)), data)
    G = rate_pass(known, x, system.at, data, use)
    scale = np.sqrt(np.outer(np.diag(whole), np.diag(whole)))
    assert np.all(np.abs(G - whole) <= BOUND * scale + 1e-12)


def test_rda_does_not_depend_on_the_base_velocity():
    """v_b enters no argument of the pass; Pinocchio with any v_b agrees."""
    import pinocchio as pin

    problem, system = system_of(("base", "target"), biases=False)
    x, block = truth(problem), random_block()
    sample = samples_of(block, 1)
    data = kernel_data(sample)._replace(s_w=np.zeros(3))
    r = residual_pass(system.arm, system.bodies(x), x, system.at, data, RDA)[0]
    model = problem.model
    model.set_parameters(problem.pi(x))
    q = np.concatenate([[0, 0, 0, 0, 0, 0, 1.0], sample.q[0]])
    H = model.mass_matrix(sample.q[0])
    for v_b in (np.zeros(3), np.array([3.0, -2.0, 5.0])):
        v = np.concatenate([v_b, sample.w_NB_B[0], sample.qd[0]])
        a = np.concatenate([np.zeros(6), sample.qdd[0]])
        c = pin.rnea(model.model, model.data, q, v, a)
        tau = c[6:] - H[6:, :6] @ np.linalg.solve(H[:6, :6], c[:6])
        assert np.abs(sample.tau[0] - r - tau).max() <= BOUND * np.abs(tau).max()
