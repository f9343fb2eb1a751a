"""The joints' motion as one curve, and the likelihood of bodies and curve together.

The knots of the planned motion are known, so a spline with few coefficients is fitted to the noisy
angles of every joint. Errors of the fit last and are common to angle, rate and acceleration. If
they were ignored, or counted as white, sigma would be far too small. So the coefficients are states
beside the bodies, with the fit as their prior, and all sensors improve them.
Source: errors in variables by their latent values, Fuller, Measurement Error Models (1987), 3.1.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import block_diag

from fsw.estimators.batch.plain import BatchSolution
from fsw.estimators.batch.solver import solve
from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.measurement.fused import predict
from fsw.estimators.measurement.impulse import Impulse
from fsw.estimators.measurement.mrnea import Rows
from fsw.estimators.measurement.row_functions import RowsFunction
from fsw.estimators.model.problem import Problem
from fsw.messages import Block
from hil.world.inertia import FloatArray
from hil.world.spline import DEGREE, REST_POINTS, JointSpline

LEAST_RAD = 1e-9  # least noise of an angle


@dataclass(frozen=True, slots=True, eq=False)
class JointCurve:
    """The motion of n joints at the N nodes of all blocks, linear in k coefficients per joint."""

    basis: FloatArray  # (3, N, k) of angle, rate and acceleration
    coefficients: FloatArray  # (k, n)
    covariance: FloatArray  # (k, k) of the coefficients of one joint, equal for all joints

    def blocks(self, blocks: Sequence[Block]) -> list[Block]:
        """Return all blocks of the curve with the motion of the curve, which counts as exact."""
        m, n = blocks[0].q_rad.shape
        q, qd, qdd = self.basis @ self.coefficients
        return [
            replace(
                block,
                q_rad=q[i * m : (i + 1) * m],
                qd_rad_s=qd[i * m : (i + 1) * m],
                qdd_rad_s2=qdd[i * m : (i + 1) * m],
                cov_joint=np.zeros((n, 2 * m, 2 * m)),
            )
            for i, block in enumerate(blocks)
        ]


def fit_curve(
    spline: JointSpline, t_s: FloatArray, q_rad: FloatArray, nodes_s: FloatArray, sigma_rad: float
) -> JointCurve:
    """Return the least-squares curve through noisy angles (N, n), evaluated at `nodes_s`."""
    at_sensed, at_nodes = _bases(spline, t_s, nodes_s)
    coefficients, *_ = np.linalg.lstsq(at_sensed, q_rad, rcond=None)
    root = np.linalg.qr(at_sensed)[1]
    inverse = np.linalg.solve(root, np.eye(len(root)))
    return JointCurve(
        basis=np.stack(at_nodes),
        coefficients=np.asarray(coefficients, dtype=np.float64),
        covariance=max(sigma_rad, LEAST_RAD) ** 2 * inverse @ inverse.T,
    )


def solve_with_motion(
    problem: Problem, blocks: Sequence[Block], curve: JointCurve, start: FloatArray
) -> BatchSolution:
    """Return the most likely states of the problem, followed by the coefficients of the curve.

    `start` (p,) are the initial states of the problem. `blocks` are all blocks of the curve.
    """
    n = curve.coefficients.shape[1]
    own = np.kron(curve.covariance, np.eye(n))
    names = [f"curve.{i}" for i in range(curve.coefficients.size)]
    joined = replace(
        problem,
        names=(*problem.names, *names),
        prior_mean=np.concatenate([problem.prior_mean, curve.coefficients.ravel()]),
        prior_covariance=block_diag(problem.prior_covariance, own),
    )
    rows = _Rows(problem, curve, {block.index: i for i, block in enumerate(blocks)})
    first = np.concatenate([start, curve.coefficients.ravel()])
    return solve(joined, rows, blocks, start=first)


class _Rows(RowsFunction):
    """Whitened rows of torque, accelerometer and gyro; the joint motion is a part of the state."""

    def __init__(self, problem: Problem, curve: JointCurve, place: dict[int, int]) -> None:
        self._problem, self._curve, self._place = problem, curve, place

    def stacked(self, s: BlockStack, x: FloatArray, before: Impulse | None = None) -> list[Rows]:
        """Return the rows of each block at x: states of the problem, then the coefficients."""
        p, m, n, B = len(self._problem.prior_mean), s.m, s.n, len(s.blocks)
        nodes = np.concatenate([np.arange(m) + m * self._place[b.index] for b in s.blocks])
        basis = self._curve.basis[:, nodes]
        motion = basis @ x[p:].reshape(self._curve.coefficients.shape)
        found = predict(_moved(s, motion), x[:p], self._problem, before=before)
        r = np.concatenate(
            [
                s.tau_nm - found.tau_nm,
                s.f_NS_B_m_s2 - found.f_m_s2,
                s.w_NB_B_rad_s - found.w_rad_s,
            ],
            axis=1,
        )
        J = np.concatenate([found.J_tau, found.J_f, found.J_w], axis=1)
        by_curve = found.D_qd[:, :, None, :] * basis[1][:, None, :, None]
        by_curve[:, : n + 3] += found.D_qdd[:, :, None, :] * basis[2][:, None, :, None]
        if found.D_q is not None:
            by_curve += found.D_q[:, :, None, :] * basis[0][:, None, :, None]
        A = np.concatenate([J, by_curve.reshape(B * m, n + 6, -1), r[:, :, None]], axis=2)
        A = A.reshape(B, m, n + 6, -1)
        for row in range(n + 6):
            inertial = s.cov_acc if row < n + 3 else s.cov_gyro[:, :m, :m]
            L = np.linalg.cholesky(s.cov_tau[:, row] if row < n else inertial)
            A[:, :, row] = np.linalg.solve(L, A[:, :, row])
        white = A.reshape(B, m * (n + 6), -1)
        return [
            Rows(own[:, :-1], own[:, -1], after)
            for own, after in zip(white, found.each, strict=True)
        ]


def _moved(s: BlockStack, motion: FloatArray) -> BlockStack:
    """Return the blocks with another joint motion (3, N, n) and a full-size joint covariance."""
    q, qd, qdd = (s.by_block(values) for values in motion)
    wide = np.zeros((s.n, 3 * s.m, 3 * s.m))
    return BlockStack(
        tuple(
            replace(block, q_rad=q[i], qd_rad_s=qd[i], qdd_rad_s2=qdd[i], cov_joint=wide)
            for i, block in enumerate(s.blocks)
        )
    )


def _bases(
    spline: JointSpline, t_s: FloatArray, nodes_s: FloatArray
) -> tuple[FloatArray, list[FloatArray]]:
    """Return the basis of rest-to-rest splines at `t_s`; and at `nodes_s` with two derivatives."""
    count = len(spline.control_points_rad)
    inner = np.linspace(0.0, spline.duration_s, count - DEGREE + 1)
    ends = np.zeros(DEGREE)
    knots = np.concatenate([ends, inner, ends + spline.duration_s])
    free = np.zeros((count, count - 2 * (REST_POINTS - 1)))
    free[:REST_POINTS, 0] = free[-REST_POINTS:, -1] = 1.0
    for k in range(REST_POINTS, count - REST_POINTS):
        free[k, k - REST_POINTS + 1] = 1.0
    curve = BSpline(knots, free, DEGREE)
    return curve(t_s), [curve(nodes_s)] + [curve.derivative(d)(nodes_s) for d in (1, 2)]
