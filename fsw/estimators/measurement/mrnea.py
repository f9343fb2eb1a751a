"""MRNEA: the paper's modified recursive Newton-Euler regression, without its bias.

Rows of one block, whitened: A delta = b for a step delta of the state at the state x. Three
weightings: `ols` (the paper's, eqs. 8-16), `wls` (known output and input noise at the prior) and
`eiv` (errors in variables: base acceleration, rates and joint accelerations are noisy regressors).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from fsw.estimators.measurement.impulse import Impulse, external_force, pulled
from fsw.estimators.model.inertia import cross, skew
from fsw.estimators.model.problem import Problem, present
from fsw.messages import Block, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Whitened rows of one block linearised at a state: residual b (k,) and Jacobian A (k, p)."""

    A: FloatArray
    b: FloatArray
    after: Impulse | None = None  # momentum gained up to the block's end; see `impulse`
    root: FloatArray | None = None  # (k, k) lower root of the noise covariance whitened with
    use: NDArray[np.bool_] | None = None  # (n + 6,) channels at each node: torque, force, rate


def base_acceleration(
    block: Block, x: FloatArray, problem: Problem, G: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return w_NB_B (m, 3) less its bias, and the classical base acceleration (m, 6) in B.

    a_b = f_S - wd x r - w x (w x r) - bias + G r, in free fall, relative to the gravity field G s
    about the base's origin. Source: rigid-body kinematics.
    """
    r, wd = problem.p_BS_m, block.wd_NB_B_rad_s2
    w = block.w_NB_B_rad_s
    if present(problem.gyro_bias):
        w = w - x[problem.gyro_bias]
    a = block.f_NS_B_m_s2 - cross(wd, r) - cross(w, cross(w, r)) + G @ r
    if present(problem.acc_bias):
        a = a - x[problem.acc_bias]
    return w, np.concatenate([a, wd], axis=1)


def field(block: Block, problem: Problem) -> FloatArray:
    """Return the gravity-gradient field (m, 3, 3) in base axes; zero where none is configured."""
    if problem.orbit is None:
        return np.zeros((len(block.t_ns), 3, 3))
    return problem.orbit.field(block, problem.window_s)


def mrnea_rows(block: Block, x: FloatArray, problem: Problem, weighting: str) -> Rows:
    """Return the whitened rows of a block, (6+n) m of them.

    With H the joint-space inertia and a the measured accelerations, r = y - Y(a) pi has covariance
    S = G Sigma_z G^T + Sigma_y, where z stacks specific force, gyro and joint-motion errors over
    all nodes of the block (wd is a derivative of the same gyro polynomial) and G = d(Y pi)/dz. The
    step's Jacobian is taken at the smoothed z + Sigma_z G^T S^-1 r, the residual at the measured
    one.

    Source: paper eqs. (3)-(16); errors-in-variables weighting as in weighted total least squares.
    """
    model, n, m = problem.model, problem.model.n, len(block.t_ns)
    pi = problem.pi(x)
    model.set_parameters(pi if weighting == "eiv" else problem.pi(problem.prior_mean))
    G = field(block, problem)
    w, a_base = base_acceleration(block, x, problem, G)
    acceleration = np.concatenate([a_base, block.qdd_rad_s2], axis=1)
    y = np.zeros((m, 6 + n))
    y[:, 6:] = block.tau_nm
    if present(problem.torque_offset):
        y[:, 6:] -= x[problem.torque_offset]
    gain = 1.0 + x[problem.torque_scale] if present(problem.torque_scale) else np.ones(n)
    y[:, 6:] /= gain
    r = np.empty((m, 6 + n))
    H, C = np.empty((2, m, 6 + n, 6 + n))
    Y = np.empty((m, 6 + n, pi.size))
    for i in range(m):
        q, qd = block.q_rad[i], block.qd_rad_s[i]
        Y_field = model.field_regressor(q, G[i]) if problem.orbit is not None else 0.0
        Y[i] = model.regressor(q, w[i], qd, acceleration[i]) - Y_field
        r[i] = y[i] - Y[i] @ pi
        H[i] = model.mass_matrix(q)
        C[i] = model.bias_derivative(q, w[i], qd, acceleration[i])
    outside = external_force(block, x, problem) if pulled(problem) else None
    if outside is not None:
        r += outside[0]
    D_w = skew(cross(w, problem.p_BS_m)) + skew(w) @ skew(problem.p_BS_m)
    G_w = C[:, :, 3:6] + H[:, :, :3] @ D_w
    G_wd = H[:, :, 3:6] + H[:, :, :3] @ skew(problem.p_BS_m)
    if weighting == "ols":
        L = np.sqrt(np.mean(np.einsum("nii->ni", block.cov_tau))) * np.eye(r.size)
    else:
        gains = _input_gains(block, H, C, G_w, G_wd).reshape(r.size, -1)
        L = np.linalg.cholesky(gains @ gains.T + _output_covariance(block, problem))
    white = solve_triangular(L, r.ravel(), lower=True)
    if weighting == "eiv":
        smoothed = gains.T @ solve_triangular(L, white, lower=True, trans=1)
        w, acceleration, qd = _smooth(block, smoothed, w, acceleration, problem)
        for i in range(m):
            Y_field = model.field_regressor(block.q_rad[i], G[i]) if problem.orbit else 0.0
            Y[i] = model.regressor(block.q_rad[i], w[i], qd[i], acceleration[i]) - Y_field
    X = np.zeros((m, 6 + n, len(x)))
    X[:, :, problem.bodies] = Y @ problem.U
    _nuisance_columns(X, y, gain, H, G_w, problem)
    if outside is not None:
        X -= outside[1]
    X = X.reshape(m * (6 + n), len(x))
    return Rows(solve_triangular(L, X, lower=True), white)


def _nuisance_columns(
    X: FloatArray, y: FloatArray, gain: FloatArray, H: FloatArray, G_w: FloatArray, problem: Problem
) -> None:
    """Fill the sensors' columns of X (m, 6+n, p)."""
    n = len(gain)
    if present(problem.torque_offset):
        X[:, 6:, problem.torque_offset] = np.diag(1.0 / gain)
    if present(problem.torque_scale):
        X[:, 6:, problem.torque_scale] = (y[:, 6:] / gain)[:, :, None] * np.eye(n)
    if present(problem.acc_bias):
        X[:, :, problem.acc_bias] = -H[:, :, :3]
    if present(problem.gyro_bias):
        X[:, :, problem.gyro_bias] = -G_w


def _input_gains(
    block: Block, H: FloatArray, C: FloatArray, G_w: FloatArray, G_wd: FloatArray
) -> FloatArray:
    """Return d(Y pi)/d(unit-variance input errors), (m, 6+n, inputs) as [f | gyro | joints].

    Each input's covariance over the block's nodes is factorised, so that S = G G^T.
    """
    m, n = block.q_rad.shape
    acc = np.linalg.cholesky(block.cov_acc)
    gyro = covariance_root(block.cov_gyro)
    # columns ordered (axis, factor)
    G_f = np.einsum("irk,if->irkf", H[:, :, :3], acc)
    G_g = np.einsum("irk,if->irkf", G_w, gyro[:m]) + np.einsum("irk,if->irkf", G_wd, gyro[m:])
    G_q = joint_gains(C[:, :, 6:], H[:, :, 6:], covariance_root(_rates(block)))
    return np.concatenate([G_f.reshape(m, 6 + n, -1), G_g.reshape(m, 6 + n, -1), G_q], axis=2)


def _rates(block: Block) -> FloatArray:
    """Return the covariance (n, 2m, 2m) of rates and accelerations; angles are taken as exact."""
    size = 2 * len(block.t_ns)
    return block.cov_joint[:, :size, :size]


def covariance_root(covariance: FloatArray) -> FloatArray:
    """Return F (..., k, k) with F F^T = covariance (..., k, k), also for singular ones."""
    values, vectors = np.linalg.eigh(covariance)
    root: FloatArray = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return root


def joint_gains(by_qd: FloatArray, by_qdd: FloatArray, root: FloatArray) -> FloatArray:
    """Return (m, rows, n 2m): rows by the joints' unit-variance errors of [qd, qdd] at the nodes.

    `by_qd`, `by_qdd` (m, rows, n) are sensitivities, `root` (n, 2m, 2m) the covariances' roots.
    """
    m = by_qd.shape[0]
    gains = np.einsum("irj,jif->irjf", by_qd, root[:, :m])
    gains += np.einsum("irj,jif->irjf", by_qdd, root[:, m:])
    stacked: FloatArray = gains.reshape(m, by_qd.shape[1], -1)
    return stacked


def _output_covariance(block: Block, problem: Problem) -> FloatArray:
    m, n = block.q_rad.shape
    S = np.zeros((m, 6 + n, m, 6 + n))
    i = np.arange(m)
    for row in range(6):
        S[i, row, i, row] = problem.wrench_sigma[row] ** 2
    for j in range(n):
        S[:, 6 + j, :, 6 + j] = block.cov_tau[j]
    return S.reshape(m * (6 + n), m * (6 + n))


def _smooth(
    block: Block, unit: FloatArray, w: FloatArray, acceleration: FloatArray, problem: Problem
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Apply unit-variance input corrections; return w, acceleration and qd at the result."""
    m, n = block.q_rad.shape
    acc = np.linalg.cholesky(block.cov_acc)
    gyro = covariance_root(block.cov_gyro)
    split = 3 * acc.shape[1]
    f = acc @ unit[:split].reshape(3, -1).T
    g = gyro @ unit[split : split + 3 * gyro.shape[1]].reshape(3, -1).T
    rest = unit[split + 3 * gyro.shape[1] :]
    dw, dwd = g[:m], g[m:]
    r = problem.p_BS_m
    smoothed = acceleration.copy()
    w_new = w + dw
    smoothed[:, :3] += f - cross(dwd, r) - cross(w_new, cross(w_new, r))
    smoothed[:, :3] += cross(w, cross(w, r))
    smoothed[:, 3:6] += dwd
    step = np.einsum("jaf,jf->aj", covariance_root(_rates(block)), rest.reshape(n, -1))
    qd = block.qd_rad_s + step[:m]
    smoothed[:, 6:] += step[m:]
    return w_new, smoothed, qd
