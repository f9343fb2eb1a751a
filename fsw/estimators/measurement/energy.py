"""CE: conservation of energy as a work-energy balance of one block.

The paper's printed cost has T_msr undefined and no motor work. As a balance it is d/dt(1/2 qd^T
Hhat(pi) qd) = tau^T qd. At zero momentum the left side is the whole kinetic energy and needs no
base velocity. The weak form is used here: the balance is multiplied by test functions phi that
vanish at the window's ends, and integrated. So nothing is differentiated, and every quantity is
needed at the nodes only:

    integral(phi tau^T qd dt) + integral(dphi/dt T(pi) dt) = 0
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre

from fsw.estimators.effects.carried import Carried
from fsw.estimators.effects.joint_torque import added, fill_columns
from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.measurement.mrnea import Rows, field, whitened
from fsw.estimators.model.problem import Problem
from fsw.messages import FloatArray


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


def stacked_energy_rows(s: BlockStack, x: FloatArray, problem: Problem) -> list[Rows]:
    """Return the whitened work-energy rows of every block, (m - 2, p); needs at least 3 nodes.

    The kinetic energy's bias by the noise of qd, 1/2 tr(Hhat Sigma_qd), is subtracted. The energy's
    gradient is 1/2 nu^T Y(q, 0, nu) with nu the whole predicted velocity. The base velocity's own
    derivative drops out, because the energy is stationary in the base velocity.
    """
    m, n, B = s.m, s.n, len(s.blocks)
    model, pi, k = problem.model, problem.pi(x), slice(0, problem.U.shape[1])
    model.set_parameters(pi)
    value, slope = _weak_form(m)
    spans_ns = np.array([block.t_ns[-1] - block.t_ns[0] for block in s.blocks])
    half_s = spans_ns * 0.5e-9 / legendre.leggauss(m)[0][-1]
    qd = s.qd_rad_s[:, :, None]
    H = model.mass_matrices(s.q_rad)[:, : 6 + n]  # an axis of a wrench sensor does no work
    N = -np.linalg.solve(H[:, :6, :6], H[:, :6, 6:])
    reduced = H[:, 6:, 6:] + H[:, :6, 6:].transpose(0, 2, 1) @ N
    nu = np.concatenate([N @ qd, qd], axis=1)[:, :, 0]
    turned = _turned(s, x, problem, H[:, :6, :6])
    if turned is not None:
        nu[:, :6] += turned.by_momentum
    p_qd = (reduced @ qd)[:, :, 0]
    own = np.einsum("bjii->bij", s.cov_joint[:, :, :m, :m]).reshape(-1, n)  # variance of qd
    T = 0.5 * np.einsum("ij,ij->i", s.qd_rad_s, p_qd)
    T -= 0.5 * np.einsum("ijj,ij->i", reduced, own)
    J_T = np.zeros((B * m, len(x)))
    Y = model.momentum_regressors(s.q_rad, nu)[:, : 6 + n]
    J_T[:, k] = 0.5 * (nu[:, None, :] @ Y)[:, 0] @ problem.U
    P, J_P = np.zeros(B * m), np.zeros((B * m, len(x)))  # power of the gravity gradient
    if problem.orbit is not None:
        G = field(s, problem)
        by_pi = (nu[:, None] @ model.field_regressors(s.q_rad, G)[:, : 6 + n])[:, 0]
        P, J_P[:, k] = by_pi @ pi, by_pi @ problem.U
    moved = np.zeros((B * m, n))  # joint torque that the carried momentum's is equivalent to
    if turned is not None:
        T, P = T + turned.energy_j, P - np.einsum("ij,ij->i", nu[:, 3:6], turned.hd_nm)
        turned.fill_columns(J_T, J_P, nu, Y[:, :6] @ problem.U, k)
        moved = (N[:, 3:].transpose(0, 2, 1) @ turned.hd_nm[:, :, None])[:, :, 0]
    work, tau = half_s[:, None, None] * value, s.tau_nm[:, :n]
    J = -slope @ s.by_block(J_T) - work @ s.by_block(J_P)
    if problem.has("torque_offset"):
        tau = tau - x[problem.at("torque_offset")]
        J[:, :, problem.at("torque_offset")] += work @ s.by_block(s.qd_rad_s)
    tau = tau - added(problem.torque_terms, s.joint_motion, x).torque_nm
    by_state = np.zeros((B * m, n, len(x)))
    fill_columns(by_state, problem.torque_terms, s.joint_motion)
    J += work @ s.by_block(np.einsum("ij,ijk->ik", s.qd_rad_s, by_state))
    power = np.einsum("ij,ij->i", tau, s.qd_rad_s) + P
    residual = (work @ s.by_block(power)[:, :, None])[:, :, 0] + s.by_block(T) @ slope.T
    S = _covariance(s, work, slope, tau - moved, p_qd)
    if turned is not None and turned.carried is not None:
        S += turned.covariance(s, work, slope, nu, turned.carried)
    L = np.linalg.cholesky(S)
    return [Rows(*whitened(*parts)) for parts in zip(L, J, residual, strict=True)]


@dataclass(frozen=True, slots=True, eq=False)
class _Turned:
    """Share of carried momentum, and of a residual one, in the balance.

    Base and arm have the momentum p = L - h, so T = 1/2 qd^T Hhat qd + 1/2 p^T H_bb^-1 p, and the
    what carries h takes the power w^T d/dt h from them.
    """

    carried: Carried | None
    hd_nm: FloatArray  # (N, 3) d/dt h; zero if none is carried
    inverse: FloatArray  # (N, 6, 6) of H_bb
    by_momentum: FloatArray  # (N, 6) base velocity H_bb^-1 [0; p]
    energy_j: FloatArray  # (N,)
    J_p: FloatArray  # (N, 3, p) dp/dx

    def fill_columns(
        self, J_T: FloatArray, J_P: FloatArray, nu: FloatArray, Y_h: FloatArray, k: slice
    ) -> None:
        """Add the derivatives of energy J_T and power J_P (N, p); `Y_h` (N, 6, k) as in fused."""
        v, hd, w = self.by_momentum, self.hd_nm, nu[:, 3:6]
        J_T[:, k] -= np.einsum("ij,ijk->ik", v, Y_h)
        J_T += np.einsum("ij,ijk->ik", v[:, 3:], self.J_p)
        back = np.einsum("ij,ijk->ik", hd, self.inverse[:, 3:])  # d(w hd)/d(base momentum)
        J_P[:, k] += np.einsum("ij,ijk->ik", back, Y_h)
        J_P -= np.einsum("ij,ijk->ik", back[:, 3:], self.J_p)
        if self.carried is not None:
            J_P -= np.einsum("ij,ijk->ik", w, self.carried.J_hd)

    def covariance(
        self, s: BlockStack, work: FloatArray, slope: FloatArray, nu: FloatArray, carried: Carried
    ) -> FloatArray:
        """Return the balances' covariance (B, m - 2, m - 2) by noise of the momenta."""
        back = np.einsum("ij,ijk->ik", self.hd_nm, self.inverse[:, 3:, 3:])
        axes = carried.axes
        by_h = np.einsum("brm,bmj->bjrm", work, s.by_block(back @ axes))
        by_h -= np.einsum("rm,bmj->bjrm", slope, s.by_block(self.by_momentum[:, 3:] @ axes))
        by_hd = -np.einsum("brm,bmj->bjrm", work, s.by_block(nu[:, 3:6] @ axes))
        by = np.concatenate([by_h, by_hd], axis=3)
        covariance: FloatArray = np.sum(by @ s.cov_carried @ by.transpose(0, 1, 3, 2), axis=1)
        return covariance


def _turned(s: BlockStack, x: FloatArray, problem: Problem, H_bb: FloatArray) -> _Turned | None:
    """Return the share of carried and residual momentum at the nodes; None if there is neither."""
    carried = problem.carrier(s, x)
    if carried is None and not problem.has("momentum"):
        return None
    p, hd_nm, J_p = *np.zeros((2, len(s.q_rad), 3)), np.zeros((len(s.q_rad), 3, len(x)))
    if carried is not None:
        p, hd_nm, J_p = -carried.h_nms, carried.hd_nm, -carried.J_h
    if problem.has("momentum"):
        R_BN = s.R_NB.transpose(0, 2, 1)
        p = p + R_BN @ x[problem.at("momentum")]
        J_p[:, :, problem.at("momentum")] += R_BN
    inverse = np.asarray(np.linalg.solve(H_bb, np.eye(6)), np.float64)
    by_momentum = (inverse[:, :, 3:] @ p[:, :, None])[:, :, 0]
    energy_j = 0.5 * np.einsum("ij,ij->i", by_momentum[:, 3:], p)
    return _Turned(carried, hd_nm, inverse, by_momentum, energy_j, J_p)


def _covariance(
    s: BlockStack, work: FloatArray, slope: FloatArray, tau: FloatArray, p_qd: FloatArray
) -> FloatArray:
    """Return the covariance (B, m - 2, m - 2) of the balances by noise of torque and rate."""
    by_tau = np.einsum("brm,bmj->bjrm", work, s.by_block(s.qd_rad_s))
    by_qd = np.einsum("brm,bmj->bjrm", work, s.by_block(tau))
    by_qd += np.einsum("rm,bmj->bjrm", slope, s.by_block(p_qd))
    rates = s.cov_joint[:, :, : s.m, : s.m]
    S = np.sum(by_tau @ s.cov_tau[:, : s.n] @ by_tau.transpose(0, 1, 3, 2), axis=1)
    S += np.sum(by_qd @ rates @ by_qd.transpose(0, 1, 3, 2), axis=1)
    floor = 1e-9 * np.trace(S, axis1=1, axis2=2) + 1e-24
    total: FloatArray = S + floor[:, None, None] * np.eye(S.shape[1])
    return total
