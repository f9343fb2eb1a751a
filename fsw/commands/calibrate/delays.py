"""Delays of gyro and accelerometer relative to the joints, as states of a batch.

A signal with stamp t and delay d shows the robot at t - d. Near the true delay, d is the unknown of
a least-squares problem whose row is the time derivative of the signal predicted from the joints.
Bodies, biases and mounting are states too, so that their effect does not appear as a delay.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre
from scipy.linalg import block_diag, solve_triangular

from fsw.estimators.conditioning.polynomial import gauss_nodes
from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.measurement.fused import stacked_fused_rows
from fsw.estimators.measurement.impulse import Impulse
from fsw.estimators.measurement.mrnea import Rows
from fsw.estimators.measurement.row_functions import RowsFunction
from fsw.estimators.model.problem import Problem
from fsw.messages import FloatArray

NAMES = ("delay.gyro", "delay.accelerometer")


def with_delays(problem: Problem, sigma_s: float) -> Problem:
    """Return the problem with two last states added: true delays less the configured ones [s]."""
    own = sigma_s**2 * np.eye(len(NAMES))
    return replace(
        problem,
        names=(*problem.names, *NAMES),
        prior_mean=np.concatenate([problem.prior_mean, np.zeros(len(NAMES))]),
        prior_covariance=block_diag(problem.prior_covariance, own),
        liquid=block_diag(problem.liquid, np.zeros_like(own)),
    )


@lru_cache(maxsize=8)
def derivative(nodes: int) -> FloatArray:
    """Return the matrix (nodes, nodes) from values at the Gauss nodes of (-1, 1) to derivatives."""
    x, unit = gauss_nodes(nodes), np.eye(nodes)
    slopes = [legendre.legval(x, legendre.legder(row)) for row in unit]
    return np.asarray(
        np.stack(slopes, axis=1) @ np.linalg.solve(legendre.legvander(x, nodes - 1), unit)
    )


class DelayedRows(RowsFunction):
    """Fused rows of a problem `with_delays`: a delay moves a prediction by -delay x derivative.

    This is first order. For a delay of more than a few ms, correct the stamps and replay again.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._slope = derivative(problem.nodes) * 2.0 / problem.window_s

    def stacked(self, s: BlockStack, x: FloatArray, before: Impulse | None = None) -> list[Rows]:
        """Return the rows of each block in `s` for the state x (p,)."""
        made = list[Rows]()
        for block in s.blocks:  # motion is joined at no edge, because delays are not carried there
            before = before and before.without_motion()
            made += stacked_fused_rows(BlockStack((block,)), x, self._problem, before=before)
            before = made[-1].after
        w, f = s.by_block(s.w_NB_B_rad_s), s.by_block(s.f_NS_B_m_s2)
        return [
            self._moved(rows, x, np.concatenate([force, rate], axis=1))
            for rows, force, rate in zip(made, f, w, strict=True)
        ]

    def _moved(self, rows: Rows, x: FloatArray, measured: FloatArray) -> Rows:
        """Return one block's rows with delays; `measured`: specific force and rate (m, 6), in B."""
        if rows.root is None or rows.use is None:
            raise ValueError("rows of a block without their noise")
        if not rows.use.any():
            return rows
        m, n = len(measured), len(rows.use) - measured.shape[1]
        residuals = np.zeros((m, len(rows.use)))
        residuals[:, rows.use] = (rows.root @ rows.b).reshape(m, -1)
        slopes = self._slope @ (measured - residuals[:, n:])
        columns = np.zeros((m, len(rows.use), len(NAMES)))
        columns[:, n + 3 :, 0], columns[:, n : n + 3, 1] = slopes[:, 3:], slopes[:, :3]
        used = columns[:, rows.use].reshape(-1, len(NAMES))
        moved = np.asarray(solve_triangular(rows.root, used, lower=True), np.float64)
        A = rows.A.copy()
        A[:, -len(NAMES) :] = -moved
        return replace(rows, A=A, b=rows.b + moved @ x[-len(NAMES) :])
