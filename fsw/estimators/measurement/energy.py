"""CE: conservation of energy as a work-energy balance of one block.

The paper's printed cost has T_msr undefined and no motor work. Read as a balance it is
d/dt(1/2 qd^T Hhat(pi) qd) = tau^T qd, where at zero momentum the left side is the whole kinetic
energy and needs no base velocity. Here in weak form: multiplied by test functions phi that vanish
at the window's ends and integrated, so that nothing is differentiated and every quantity stands at
the nodes:

    integral(phi tau^T qd dt) + integral(dphi/dt T(pi) dt) = 0
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre
from scipy.linalg import solve_triangular

from fsw.estimators.measurement.mrnea import Rows, field
from fsw.estimators.model.problem import Problem, present
from fsw.messages import Block, FloatArray


@lru_cache(maxsize=8)
def _weak_form(nodes: int) -> tuple[FloatArray, FloatArray]:
    """Return quadrature rows for phi and dphi/ds on (-1, 1), each (nodes - 2, nodes).

    phi_k = (1 - s^2) P_k'(s) for k = 1 .. nodes - 2; the rule is exact up to degree 2 nodes - 1.
    """
    points, weights = legendre.leggauss(nodes)
    value = np.empty((nodes - 2, nodes))
    slope = np.empty((nodes - 2, nodes))
    for k in range(1, nodes - 1):
        unit = np.eye(nodes)[k]
        value[k - 1] = weights * (1 - points**2) * legendre.legval(points, legendre.legder(unit))
        # Legendre's equation: d/ds[(1 - s^2) P_k'] = -k (k + 1) P_k
        slope[k - 1] = -weights * k * (k + 1) * legendre.legval(points, unit)
    return value, slope


def energy_rows(block: Block, x: FloatArray, problem: Problem) -> Rows:
    """Return the whitened work-energy rows of one block, (m - 2, p); needs at least 3 nodes.

    The kinetic energy's bias by the noise of qd, 1/2 tr(Hhat Sigma_qd), is taken off. Its gradient
    is 1/2 nu^T Y(q, 0, nu) with nu the whole predicted velocity: at the momentum's stationary point
    the base velocity's own derivative drops out.
    """
    m, n = block.q_rad.shape
    model, pi = problem.model, problem.pi(x)
    model.set_parameters(pi)
    value, slope = _weak_form(m)
    half_s = (block.t_ns[-1] - block.t_ns[0]) * 0.5e-9 / legendre.leggauss(m)[0][-1]
    T = np.empty(m)
    J_T = np.zeros((m, len(x)))
    p_qd = np.empty((m, n))
    P, J_P = np.zeros(m), np.zeros((m, len(x)))  # power of the gravity gradient
    G = field(block, problem)
    for i in range(m):
        q, qd = block.q_rad[i], block.qd_rad_s[i]
        H = model.mass_matrix(q)
        N = -np.linalg.solve(H[:6, :6], H[:6, 6:])
        reduced = H[6:, 6:] + H[:6, 6:].T @ N
        nu = np.concatenate([N @ qd, qd])
        p_qd[i] = reduced @ qd
        cov_qd = block.cov_joint[:, i, i]
        T[i] = 0.5 * qd @ p_qd[i] - 0.5 * np.diag(reduced) @ cov_qd
        if problem.orbit is not None:
            by_pi = nu @ model.field_regressor(q, G[i])
            P[i], J_P[i, problem.bodies] = by_pi @ pi, by_pi @ problem.U
        J_T[i, problem.bodies] = 0.5 * nu @ model.momentum_regressor(q, nu) @ problem.U
    tau = block.tau_nm
    work = half_s * value
    J = -slope @ J_T - work @ J_P
    if present(problem.torque_offset):
        tau = tau - x[problem.torque_offset]
        J[:, problem.torque_offset] += work @ block.qd_rad_s
    residual = work @ (np.einsum("ij,ij->i", tau, block.qd_rad_s) + P) + slope @ T
    S = np.zeros((m - 2, m - 2))
    for j in range(n):
        by_tau = work * block.qd_rad_s[:, j]
        S += by_tau @ block.cov_tau[j] @ by_tau.T
        by_qd = work * tau[:, j] + slope * p_qd[:, j]
        S += by_qd @ block.cov_joint[j][:m, :m] @ by_qd.T
    S += 1e-9 * np.trace(S) * np.eye(m - 2) + 1e-24 * np.eye(m - 2)
    L = np.linalg.cholesky(S)
    return Rows(solve_triangular(L, J, lower=True), solve_triangular(L, residual, lower=True))
