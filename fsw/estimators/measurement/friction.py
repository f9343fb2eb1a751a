"""Friction of joints on the link side: what bearings, seals and cables add to a measured torque.

    measured = (tau + c shape(qd) + d qd) (1 + scale) + offset            c, d: states

`reversal` gives the shape of Coulomb friction over a window.
"""

import numpy as np

from fsw.estimators import reversal
from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.model.problem import Problem, present
from fsw.messages import FloatArray


def torque(s: BlockStack, x: FloatArray, problem: Problem) -> tuple[FloatArray, FloatArray]:
    """Return friction at the nodes (N, n) [N m] and its derivative by the same node's rate.

    The derivative serves for the noise of rates only; the neighbouring nodes' share is left out.
    """
    friction, by_rate = np.zeros_like(s.qd_rad_s), np.zeros_like(s.qd_rad_s)
    if present(problem.at("friction_viscous")):
        viscous = x[problem.at("friction_viscous")]
        friction += viscous * s.qd_rad_s
        by_rate += viscous
    if present(problem.at("friction_coulomb")):
        coulomb = x[problem.at("friction_coulomb")]
        shape, slope = _shape(s, problem)
        friction += coulomb * shape
        by_rate += coulomb * slope
    return friction, by_rate


def fill_columns(J: FloatArray, s: BlockStack, problem: Problem) -> None:
    """Add the derivatives by the friction's states to torque rows J (N, n, p)."""
    diagonal = np.eye(s.n)
    if present(problem.at("friction_viscous")):
        J[:, :, problem.at("friction_viscous")] += s.qd_rad_s[:, :, None] * diagonal
    if present(problem.at("friction_coulomb")):
        J[:, :, problem.at("friction_coulomb")] += _shape(s, problem)[0][:, :, None] * diagonal


def _shape(s: BlockStack, problem: Problem) -> tuple[FloatArray, FloatArray]:
    shape, slope = reversal.shape(s.by_block(s.qd_rad_s), problem.friction_speed_rad_s)
    return shape.reshape(-1, s.n), slope.reshape(-1, s.n)
