"""MRNEA compensated for its bias: the linear regression less what noise adds to its normal matrix.

The regressor contains noisy accelerations and is affine in them: Y(a) = Y(0) + sum_k a_k Y_k with
Y_k = Y(q, 0, e_k). So the expected normal matrix F = sum Y^T W Y is too large by

    C = sum_kl (Sigma_a)_kl Y_k^T W Y_l

and (F - C)_uu x = g_u - (F - C)_uk pi_k is free of the bias. C covers all columns and all noisy
accelerations of all nodes. Only the sums are kept. With D_f = dY/dz_f for unit-variance errors z_f
this is C = sum_f D_f^T W D_f, and of the known parameters only their product with D_f is needed.
Source: Fuller, Measurement Error Models (1987), sec. 3.1.

The rest of the bias is as uncertain as the declared noise. Its share is judged from the variance of
the residuals, and the published covariance includes it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from fsw.errors import EstimatorError
from fsw.estimators.effects.joint_torque import fill_columns
from fsw.estimators.measurement.block_stack import BlockStack, covariance_root
from fsw.estimators.measurement.impulse import external_force, pulled
from fsw.estimators.measurement.motion_noise import through
from fsw.estimators.measurement.mrnea import base_acceleration, field
from fsw.estimators.measurement.wheels import Wheels, turning
from fsw.estimators.model.inertia import cross, skew
from fsw.estimators.model.problem import Problem, present
from fsw.messages import Block, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class CompensatedSums:
    """Sums over blocks, which act on [x, -1]; index -1 is the side of measured and known values."""

    F: FloatArray  # (p + 1, p + 1) of [X, y]^T W [X, y], y the measured less the known bodies' part
    C: FloatArray  # (p + 1, p + 1) what noise adds to F on average
    T: FloatArray  # (p, p) covariance of the noise's product with the residual
    expected: float  # squared whitened residuals that the declared noise gives

    def __add__(self, other: CompensatedSums) -> CompensatedSums:
        """Return the sums of both."""
        return CompensatedSums(
            self.F + other.F, self.C + other.C, self.T + other.T, self.expected + other.expected
        )


def no_sums(p: int) -> CompensatedSums:
    """Return the sums over no block."""
    return CompensatedSums(
        np.zeros((p + 1, p + 1)), np.zeros((p + 1, p + 1)), np.zeros((p, p)), 0.0
    )


def acceleration_root(block: Block, problem: Problem) -> FloatArray:
    """Return K (m, 6+n, f): errors of [a_b, wd, qdd] at the nodes per unit-variance error.

    The f errors are of accelerometer and gyro derivative per axis (a_b = f - wd x r), then of qdd.
    """
    m, n = block.q_rad.shape
    acc = covariance_root(block.cov_acc)
    gyro = covariance_root(block.cov_gyro[m:, m:])
    joints = [covariance_root(block.cov_joint[j][m : 2 * m, m : 2 * m]) for j in range(n)]
    widths = [acc.shape[1]] * 3 + [gyro.shape[1]] * 3 + [root.shape[1] for root in joints]
    K = np.zeros((m, 6 + n, sum(widths)))
    start = np.concatenate([[0], np.cumsum(widths)])
    lever = skew(problem.p_BS_m)
    for axis in range(3):
        K[:, axis, start[axis] : start[axis + 1]] = acc
        columns = slice(start[3 + axis], start[4 + axis])
        K[:, 3 + axis, columns] = gyro
        K[:, :3, columns] += lever[:, axis, None] * gyro[:, None, :]
    for j, root in enumerate(joints):
        K[:, 6 + j, start[6 + j] : start[7 + j]] = root
    return K


def block_sums(block: Block, x: FloatArray, problem: Problem) -> CompensatedSums:
    """Return the sums of one block.

    Weights W are the inverse of a covariance of the rows at the prior's parameters. The columns of
    the accelerometer's and the gyro's bias, bilinear with the bodies, are evaluated at the state x.

    Raises
    ------
    EstimatorError for a robot with thrusters.
    """
    if len(problem.thrusters):
        raise EstimatorError("weighting 'bc' cannot take thrusters")
    model, n, m = problem.model, problem.model.n, len(block.t_ns)
    p, k = len(x), problem.bodies
    at_prior = np.append(problem.prior_mean[k], 1.0)
    at_x = np.append(x[k], 1.0)
    at_x_known = np.append(x[k], -1.0)  # after the known part has changed sides
    columns = np.column_stack([problem.U, problem.pi_known])  # of [unknown bodies, known part]
    G_field = field(block, problem)
    w, a_base = base_acceleration(block, problem.prior_mean, problem, G_field)
    acceleration = np.concatenate([a_base, block.qdd_rad_s2], axis=1)
    Y = np.empty((m, 6 + n, columns.shape[1]))
    Y_k = np.empty((m, 6 + n, 6 + n, columns.shape[1]))  # by node, acceleration, row, column
    unit = np.eye(6 + n)
    of_links = model.regressors(block.q_rad, w, block.qd_rad_s, acceleration)
    if problem.orbit is not None:
        of_links -= model.field_regressors(block.q_rad, G_field)
    for i, q in enumerate(block.q_rad):
        Y[i] = of_links[i] @ columns
        for a in range(6 + n):
            Y_k[i, a] = model.momentum_regressor(q, unit[a]) @ columns
    K = acceleration_root(block, problem)
    D = np.einsum("iaf,iarc->irfc", K, Y_k)  # (m, 6+n, f, c)
    size, f = m * (6 + n), K.shape[2]
    output = _output_covariance(block, problem)
    wheels = _wheels(block, x, problem, w, output)
    L = np.linalg.cholesky(_weight_covariance(K, Y_k @ at_prior) + output)
    X = np.zeros((m, 6 + n, p + 1))
    X[:, :, k] = Y[:, :, :-1]
    X[:, :, p] = -Y[:, :, -1]
    X[:, 6:, p] += block.tau_nm
    _nuisance_columns(
        X, Y_k[:, :3].transpose(0, 2, 1, 3) @ at_x, block, (x, w, acceleration), problem
    )
    if wheels is not None:
        X[:, 3:6, p] -= wheels.moment(w)
        if present(problem.at("gyro_bias")):
            X[:, 3:6, problem.at("gyro_bias")] -= wheels.by_rate()
    white = solve_triangular(L, X.reshape(size, p + 1), lower=True)
    body = [*range(k.stop), p]
    D[..., -1] *= -1.0  # the known part stands on the measured side
    noise = solve_triangular(L, D.reshape(size, -1), lower=True).reshape(size * f, -1)
    C = np.zeros((p + 1, p + 1))
    C[np.ix_(body, body)] = noise.T @ noise
    # the score's covariance: X^T W S W X, and over pairs (f, g) D_f^T W G_g (D_g^T W G_f)^T
    white_G = solve_triangular(L, (D @ at_x_known).reshape(size, f), lower=True)
    V = white_G @ white_G.T
    V += solve_triangular(L, solve_triangular(L, output, lower=True).T, lower=True)
    E = np.einsum("rfc,rg->fgc", noise.reshape(size, f, -1), white_G)[:, :, : k.stop]
    T = white[:, :p].T @ V @ white[:, :p]
    T[k, k] += np.einsum("fgc,gfd->cd", E, E)
    return CompensatedSums(white.T @ white, C, 0.5 * (T + T.T), float(np.trace(V)))


def _wheels(
    block: Block, x: FloatArray, problem: Problem, w: FloatArray, output: FloatArray
) -> Wheels | None:
    """Return the wheels, or None; add the noise of their moment to the covariance `output`."""
    stack, (m, n) = BlockStack((block,)), block.q_rad.shape
    wheels = turning(stack, x, problem)
    if wheels is not None:
        own = stack.cov_wheel.reshape(1, -1, 2, m, 2, m)
        noise = through(stack, wheels.by_motion(w), own)
        noise += through(stack, wheels.by_rate()[None], _per_axis(block.cov_gyro[:m, :m]))
        output.reshape(m, 6 + n, m, 6 + n)[:, 3:6, :, 3:6] += noise[0]
    return wheels


def _per_axis(covariance: FloatArray) -> FloatArray:
    """Return the covariance (m, m) of one axis three times, in the shape that `through` needs."""
    m = len(covariance)
    return np.repeat(covariance[None, None], 3, axis=1).reshape(1, 3, 1, m, 1, m)


def _nuisance_columns(
    X: FloatArray,
    H_acc: FloatArray,
    block: Block,
    at: tuple[FloatArray, FloatArray, FloatArray],
    problem: Problem,
) -> None:
    """Fill the sensors' and the wrench's columns of X (m, 6+n, p+1).

    `H_acc` (m, 6+n, 3) is the inertia against base accelerations; `at` holds state, rate and
    acceleration. All columns are linearised at zero error. No row of MRNEA depends on the momentum.
    """
    n = problem.model.n
    x, w, acceleration = at
    if present(problem.at("torque_offset")):
        X[:, 6:, problem.at("torque_offset")] = np.eye(n)
    fill_columns(X[:, 6:], problem.torque_terms, BlockStack((block,)).joint_motion)
    if present(problem.at("torque_scale")):
        X[:, 6:, problem.at("torque_scale")] = block.tau_nm[:, :, None] * np.eye(n)
    if present(problem.at("acc_bias")):
        X[:, :, problem.at("acc_bias")] = -H_acc
    if present(problem.at("gyro_bias")):
        problem.model.set_parameters(problem.pi(x))
        lever = skew(problem.p_BS_m)
        X[:, :, problem.at("gyro_bias")] = -H_acc @ (
            skew(cross(w, problem.p_BS_m)) + skew(w) @ lever
        )
        for i, (q, qd) in enumerate(zip(block.q_rad, block.qd_rad_s, strict=True)):
            C = problem.model.bias_derivative(q, w[i], qd, acceleration[i])
            X[i, :, problem.at("gyro_bias")] -= C[:, 3:6]
    if pulled(problem):
        X[:, :, : len(x)] -= external_force(block, x, problem)[1]


def _weight_covariance(K: FloatArray, H: FloatArray) -> FloatArray:
    """Return the rows' covariance for uncorrelated nodes; H (m, a, r) by acceleration and row.

    With correlation, combinations that are noise-free only at wrong parameters would have weight.
    """
    m, _, rows = H.shape
    S = np.zeros((m, rows, m, rows))
    for i in range(m):
        S[i, :, i, :] = H[i].T @ (K[i] @ K[i].T) @ H[i]
    return S.reshape(m * rows, m * rows)


def _output_covariance(block: Block, problem: Problem) -> FloatArray:
    m, n = block.q_rad.shape
    S = np.zeros((m, 6 + n, m, 6 + n))
    i = np.arange(m)
    for row in range(6):
        S[i, row, i, row] = problem.wrench_sigma[row] ** 2
    for j in range(n):
        S[:, 6 + j, :, 6 + j] = block.cov_tau[j]
    return S.reshape(m * (6 + n), m * (6 + n))


def _root(sums: CompensatedSums, prior_precision: FloatArray) -> FloatArray:
    """Return the Cholesky factor of the compensated normal matrix; else raise EstimatorError."""
    p = len(prior_precision)
    try:
        root = np.linalg.cholesky(sums.F[:p, :p] - sums.C[:p, :p] + prior_precision)
    except np.linalg.LinAlgError as error:
        raise EstimatorError("noise explains the excitation so far") from error
    return np.asarray(root, np.float64)


def compensated_mean(
    sums: CompensatedSums, prior_mean: FloatArray, prior_precision: FloatArray
) -> FloatArray:
    """Return the state (p,) that solves the compensated equations.

    Raises
    ------
    EstimatorError while noise explains the data's excitation.
    """
    p, root = len(prior_mean), _root(sums, prior_precision)
    g = sums.F[:p, p] - sums.C[:p, p] + prior_precision @ prior_mean
    y = solve_triangular(root, g, lower=True)
    x: FloatArray = solve_triangular(root, y, lower=True, trans=1)
    return x


def compensated_solution(
    sums: CompensatedSums, prior_mean: FloatArray, prior_precision: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return state (p,), covariance (p, p) and the removed bias (p,).

    Covariance: the sandwich M^-1 T M^-1 of the compensated equations, plus the square of the
    removed bias times the relative uncertainty of the noise's variance.

    Raises
    ------
    EstimatorError while noise explains the data's excitation: M is not positive definite.
    """
    p = len(prior_mean)
    root = _root(sums, prior_precision)

    def solve(b: FloatArray) -> FloatArray:
        y: FloatArray = solve_triangular(root, b, lower=True)
        z: FloatArray = solve_triangular(root, y, lower=True, trans=1)
        return z

    x = compensated_mean(sums, prior_mean, prior_precision)
    score = sums.T + prior_precision
    covariance = solve(solve(score).T)
    extended = np.append(x, -1.0)
    squares = float(extended @ sums.F @ extended)
    variance = squares / max(1.0, sums.expected - p)
    doubt = abs(variance - 1.0) + np.sqrt(2.0 / max(1.0, sums.expected))
    bias = solve(sums.C[:p] @ extended)
    covariance = max(1.0, variance) * covariance + doubt**2 * np.outer(bias, bias)
    covariance = 0.5 * (covariance + covariance.T)
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    if np.linalg.eigvalsh(covariance / np.outer(scale, scale))[0] < 1e-13:
        raise EstimatorError("the covariance is singular to working precision")
    return x, covariance, bias
