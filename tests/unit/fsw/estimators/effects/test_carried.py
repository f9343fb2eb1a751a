"""Reaction wheels in the measurement models: gyrostat against explicit rotors, Jacobians, noise."""

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from fsw.estimators.measurement import energy
from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.measurement.fused import predict
from fsw.estimators.measurement.motion_noise import residual_covariance
from fsw.estimators.measurement.row_functions import row_function
from fsw.estimators.model.problem import Problem
from fsw.messages import Block
from tests.support.estimator_cases import N, make_problem, random_block, robot_model
from tests.support.one_block import energy_rows, mrnea_rows
from tests.support.slopes import FIELDS, assert_state_slopes, predicted_fields
from tests.support.wheel_cases import (
    INERTIA_KG_M2,
    PYRAMID,
    problem_with_wheels,
    turning,
)

RATES = ("momentum", "measured")


def case(seed: int = 1, **options: Any) -> tuple[Problem, np.ndarray, Block]:
    problem = problem_with_wheels(momentum_sigma_nms=1.0, **options)
    x = problem.prior_mean.copy()
    x[20:] = 0.1 * np.random.default_rng(seed).normal(size=len(x) - 20)
    return problem, x, turning(random_block(seed), seed)


def with_rotors(problem: Problem, x: np.ndarray) -> pin.Model:
    """Return the robot with each wheel as a body on a joint of its own; its locked share moved."""
    model = robot_model().model.copy()
    pi = problem.pi(x)
    for index in range(1, model.njoints):
        own = pi[10 * (index - 1) : 10 * index]
        model.inertias[index] = pin.Inertia.FromDynamicParameters(own)
    scales = 1.0 + x[problem.at("wheel_scale")]
    for k, axis in enumerate(PYRAMID):
        J, place = INERTIA_KG_M2 * scales[k], pin.SE3(np.eye(3), np.array([0.3, -0.2, 0.1 * k]))
        joint = model.addJoint(1, pin.JointModelRevoluteUnaligned(axis), place, f"rotor {k}")
        locked = 0.7 * J * np.eye(3) + 0.3 * J * np.outer(axis, axis)
        rotor = pin.Inertia(3.0, np.zeros(3), locked)
        model.appendBodyToJoint(joint, rotor, pin.SE3.Identity())
        model.inertias[1] = pin.Inertia.FromDynamicParameters(
            model.inertias[1].toDynamicParameters() - place.act(rotor).toDynamicParameters()
        )
    return model


@pytest.mark.parametrize("seed", [1, 2])
def test_the_prediction_is_that_of_a_robot_with_explicit_rotors(seed: int) -> None:
    """Pinocchio's dynamics of base, arm and four rotors: free base, zero wrench."""
    problem, x, block = case(seed)
    x[problem.bodies.stop :] = 0.0
    x[problem.at("wheel_scale")] = [0.1, -0.2, 0.3, 0.05]
    found, model = predict(block, x, problem), with_rotors(problem, x)
    data, nv, r = model.createData(), model.nv, problem.p_BS_m
    assert nv == 6 + N + 4
    for i in range(len(block.t_ns)):
        q = pin.neutral(model)
        q[7 : 7 + N], q[7 + N :] = block.q_rad[i], [0.4, 1.0, 2.0, 3.0]
        speed, slope = block.carried_nms[i] / INERTIA_KG_M2, block.carried_nm[i] / INERTIA_KG_M2
        H = pin.crba(model, data, q)
        H = np.triu(H) + np.triu(H, 1).T
        rates = np.concatenate([block.qd_rad_s[i], speed])
        base = -np.linalg.solve(H[:6, :6], H[:6, 6:] @ rates)  # zero momentum in all
        np.testing.assert_allclose(found.w_rad_s[i], base[3:], rtol=1e-9, atol=1e-10)
        v = np.concatenate([np.zeros(3), base[3:], rates])
        a = np.concatenate([np.zeros(6), block.qdd_rad_s2[i], slope])
        a[:6] = -np.linalg.solve(H[:6, :6], pin.rnea(model, data, q, v, a)[:6])
        force = pin.rnea(model, data, q, v, a)
        np.testing.assert_allclose(force[:6], 0.0, atol=1e-9)
        np.testing.assert_allclose(found.tau_nm[i], force[6 : 6 + N], rtol=1e-9, atol=1e-9)
        w, wd = base[3:], a[3:6]
        f = a[:3] + np.cross(wd, r) + np.cross(w, np.cross(w, r))
        np.testing.assert_allclose(found.f_m_s2[i], f, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("rate", RATES)
def test_state_jacobians_are_the_derivatives(rate: Any) -> None:
    problem, x, block = case(doubt=True)
    x[20:] *= 0.1
    assert problem.names[problem.at("wheel_scale").start] == "wheel_scale.wheel1"
    assert_state_slopes(
        lambda x: predict(block, x, problem, rate),
        x,
        lambda k: 1e-5 * max(1.0, abs(x[k])),
        rtol=2e-5,
        of_slope=1e-6,
        rounding=1e-10,
        fields=predicted_fields(rate),
    )


@pytest.mark.parametrize("rate", RATES)
def test_the_gain_of_a_wheel_s_motion_is_the_derivative(rate: Any) -> None:
    problem, x, block = case(doubt=True)
    found = predict(block, x, problem, rate)
    assert found.D_carried is not None
    for order, name in enumerate(("carried_nms", "carried_nm")):
        for k in range(len(PYRAMID)):
            step = 1e-4 * np.eye(len(PYRAMID))[k]
            up, down = (
                predict(replace(block, **{name: getattr(block, name) + s * step}), x, problem, rate)
                for s in (1.0, -1.0)
            )
            slope = np.concatenate(
                [(getattr(up, f) - getattr(down, f)) / 2e-4 for f in FIELDS], axis=1
            )
            got = found.D_carried[order, :, :, k]
            np.testing.assert_allclose(got, slope, rtol=1e-5, atol=1e-8)


def test_noise_of_the_wheels_is_in_the_residuals_covariance() -> None:
    """Sampled: the covariance of predictions over draws of the wheels' errors."""
    problem, x, block = case()
    use = np.ones(N + 6, np.bool_)
    quiet = replace(block, cov_carried=0.0 * block.cov_carried)
    S = [
        residual_covariance(s, predict(s, x, problem), use, "momentum")[0]
        for s in (BlockStack((block,)), BlockStack((quiet,)))
    ]
    rng, m = np.random.default_rng(3), len(block.t_ns)
    roots = np.linalg.cholesky(block.cov_carried)
    draws = []
    for _ in range(4000):
        errors = np.einsum("kij,kj->ik", roots, rng.normal(size=roots.shape[:2]))
        moved = replace(
            block,
            carried_nms=block.carried_nms + errors[:m],
            carried_nm=block.carried_nm + errors[m:],
        )
        p = predict(moved, x, problem)
        draws.append(np.concatenate([p.tau_nm, p.f_m_s2, p.w_rad_s], axis=1).ravel())
    sampled, expected = np.cov(np.array(draws).T), S[0] - S[1]
    scale = np.sqrt(np.diag(expected))
    assert np.abs((sampled - expected) / np.outer(scale, scale)).max() < 0.1


@pytest.mark.parametrize("weighting", ["ols", "wls", "eiv"])
def test_mrnea_fits_what_the_model_with_wheels_predicts(weighting: str) -> None:
    """Measurements made of the prediction leave no residual, at any state."""
    problem, x, block = case()
    made = consistent(block, x, problem)
    rows = mrnea_rows(made, x, problem, weighting)
    still = replace(made, carried_nms=0.0 * made.carried_nms, carried_nm=0.0 * made.carried_nm)
    assert np.abs(rows.b).max() < 1e-6
    assert np.abs(mrnea_rows(still, x, problem, weighting).b).max() > 0.1


def consistent(block: Block, x: np.ndarray, problem: Problem) -> Block:
    """Return the block with sensors that measure what the momentum's prediction says."""
    p = predict(block, x, problem)
    quiet = x.copy()
    for part in (problem.at("acc_bias"), problem.at("gyro_bias")):
        quiet[part] = 0.0
    w = p.w_rad_s - (x[problem.at("gyro_bias")] if problem.has("gyro_bias") else 0.0)
    # wd from the accelerometer at two places: the base's predicted angular acceleration
    force, lever = [], np.eye(3)
    for place in (np.zeros(3), *lever):
        at = predict(block, quiet, replace(problem, p_BS_m=place))
        force.append(at.f_m_s2)
    tilted = np.stack([f - force[0] for f in force[1:]], axis=2)  # (m, 3, 3): [wd x] + [w x]^2
    turned = np.stack([np.cross(np.eye(3), v).T for v in w])
    skew = tilted - turned @ turned
    wd = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    return replace(
        block, tau_nm=p.tau_nm, f_NS_B_m_s2=p.f_m_s2, w_NB_B_rad_s=p.w_rad_s, wd_NB_B_rad_s2=wd
    )


def test_the_mrnea_column_of_a_wheel_s_inertia_is_the_derivative() -> None:
    problem, x, block = case()
    k = problem.at("wheel_scale")
    for j in range(k.start, k.stop):
        d = 1e-4 * np.eye(len(x))[j]
        rows = {s: mrnea_rows(block, x + s * d, problem, "ols") for s in (-1.0, 0.0, 1.0)}
        slope = -(rows[1.0].b - rows[-1.0].b) / 2e-4
        np.testing.assert_allclose(
            rows[0.0].A[:, j], slope, rtol=1e-6, atol=1e-6 * np.abs(slope).max()
        )


def test_energy_jacobian_is_the_derivative(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, x, block = case(biases=False)
    block = replace(block, cov_joint=1e-12 * block.cov_joint)
    monkeypatch.setattr(energy, "whitened", lambda _, J, b: (J, b))
    found = energy_rows(block, x, problem)
    for k in range(len(x)):
        h = 1e-5 * max(1.0, abs(x[k]))
        d = h * np.eye(len(x))[k]
        up, down = (energy_rows(block, x + sign * d, problem).b for sign in (1.0, -1.0))
        slope, scale = -(up - down) / (2.0 * h), np.abs(found.A).max()
        np.testing.assert_allclose(found.A[:, k], slope, rtol=1e-5, atol=1e-6 * scale + 1e-11 / h)


@pytest.mark.parametrize("method", ["mrnea", "rda", "cm", "ce", "fused"])
def test_wheels_that_stand_still_change_no_row(method: str) -> None:
    still = turning(random_block())
    still = replace(
        still, **{k: 0.0 * getattr(still, k) for k in ("carried_nms", "carried_nm", "cov_carried")}
    )
    with_wheels, without = problem_with_wheels(), make_problem(("base", "target"))
    x = without.prior_mean
    own = row_function(method, "eiv", with_wheels)(still, with_wheels.prior_mean)
    plain = row_function(method, "eiv", without)(random_block(), x)
    np.testing.assert_allclose(own.b, plain.b, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(
        own.A[:, : len(x)], plain.A, rtol=1e-9, atol=1e-9 * np.abs(plain.A).max()
    )
    assert not own.A[:, len(x) :].any()


def test_blocks_of_another_robot_s_wheels_are_refused() -> None:
    with pytest.raises(ValueError, match="blocks of 0 momenta; the robot has 4"):
        predict(random_block(), problem_with_wheels().prior_mean, problem_with_wheels())


@pytest.mark.parametrize("rate", RATES)
def test_the_column_of_a_wheel_s_delay_is_the_derivative(rate: Any) -> None:
    problem = problem_with_wheels(momentum_sigma_nms=1.0, wheel={"delay_sigma_s": 1e-3})
    x, block = problem.prior_mean.copy(), turning(random_block(1), 1)
    x[problem.at("wheel_delay")] = [1e-3, -2e-3, 0.0, 3e-3]
    assert_state_slopes(
        lambda x: predict(block, x, problem, rate),
        x,
        lambda _: 1e-5,
        rtol=1e-6,
        of_slope=1e-6,
        rounding=0.0,
        fields=predicted_fields(rate),
        states=range(len(x))[problem.at("wheel_delay")],
    )


def test_a_delayed_wheel_is_read_later() -> None:
    """Momentum and torque that are polynomials of the nodes: shifted exactly, to first order."""
    problem = problem_with_wheels(wheel={"delay_sigma_s": 1e-3})
    block = turning(random_block(1), 1)
    t_s = 0.5 * problem.window_s * np.polynomial.legendre.leggauss(len(block.t_ns))[0]
    rates = np.array([0.3, -0.2, 0.1, 0.4])
    block = replace(
        block,
        carried_nms=1.0 + np.outer(t_s, rates) + np.outer(0.5 * t_s**2, 10.0 * rates),
        carried_nm=rates + np.outer(t_s, 10.0 * rates),
    )
    x, late_s = problem.prior_mean.copy(), 1e-4
    x[problem.at("wheel_delay")] = late_s
    found = problem.carrier(BlockStack((block,)), x)
    assert found is not None
    later = rates + np.outer(t_s + late_s, 10.0 * rates)
    np.testing.assert_allclose(found.hd_nm, later @ PYRAMID, rtol=0, atol=1e-9)
    moved = block.carried_nms + late_s * block.carried_nm
    np.testing.assert_allclose(found.h_nms, moved @ PYRAMID, rtol=0, atol=1e-12)
