"""CM as printed (paper eqs. 30-31): base velocity and rate; no flight sensor gives the velocity.

Each node gives six rows, [v_b; w_b] = -H_bb^-1 H_bm qd, for the iteration of the flight software.
The rows have the noise of velocity and gyro; the joint motion counts as exact.
"""

from collections.abc import Mapping

import numpy as np
from scipy.linalg import solve_triangular

from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.measurement.impulse import Impulse
from fsw.estimators.measurement.mrnea import Rows
from fsw.estimators.measurement.row_functions import RowsFunction
from fsw.estimators.model.problem import Problem
from fsw.messages import Block
from hil.world.inertia import FloatArray


class PrintedMomentum(RowsFunction):
    """Whitened rows of base velocity and rate of a block with m nodes.

    Parameters
    ----------
    velocity_m_s : (m, 3) measured velocity of the base's origin in B at the nodes, by block index
    sigma_m_s : 1 sigma of the velocity, white over the nodes
    """

    def __init__(
        self, problem: Problem, velocity_m_s: Mapping[int, FloatArray], sigma_m_s: float
    ) -> None:
        self._problem, self._velocity, self._sigma = problem, velocity_m_s, sigma_m_s

    def stacked(self, s: BlockStack, x: FloatArray, before: Impulse | None = None) -> list[Rows]:
        """Return the rows of each block at the state x."""
        return [self._rows(block, x, before) for block in s.blocks]

    def _rows(self, block: Block, x: FloatArray, before: Impulse | None) -> Rows:
        problem, m = self._problem, len(block.t_ns)
        model = problem.model
        model.set_parameters(problem.pi(x))
        A, r = np.zeros((m, 6, len(x))), np.empty((m, 6))
        measured = np.concatenate([self._velocity[block.index], block.w_NB_B_rad_s], axis=1)
        for i, (q, qd) in enumerate(zip(block.q_rad, block.qd_rad_s, strict=True)):
            H = model.mass_matrix(q)
            twist = -np.linalg.solve(H[:6, :6], H[:6, 6:] @ qd)
            Y = model.momentum_regressor(q, np.concatenate([twist, qd]))[:6] @ problem.U
            A[i, :, problem.bodies] = -np.linalg.solve(H[:6, :6], Y)
            r[i] = measured[i] - twist
        A[:, :3] /= self._sigma
        r[:, :3] /= self._sigma
        L = np.linalg.cholesky(block.cov_gyro[:m, :m])
        for row in (3, 4, 5):
            A[:, row] = solve_triangular(L, A[:, row], lower=True)
            r[:, row] = solve_triangular(L, r[:, row], lower=True)
        return Rows(A.reshape(6 * m, -1), r.ravel(), before)
