"""Covariance of a block's residuals by the noise of its joint motion and of a measured rate.

The channels are predicted from joint motion that is known through noisy angles. Errors of angle,
rate and acceleration are correlated over the nodes of a block, and enter every channel through the
exact sensitivities of the prediction.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fsw.estimators.measurement.block_stack import BlockStack
from fsw.estimators.measurement.prediction import Prediction, Rate
from fsw.messages import FloatArray


def residual_covariance(
    s: BlockStack, prediction: Prediction, use: NDArray[np.bool_], rate: Rate
) -> FloatArray:
    """Return the covariances (B, k, k) of the stacked residuals, node-major, of channels in use."""
    m, n, t, B = s.m, s.n, s.t, len(s.blocks)
    S = np.zeros((B, m, t + 6, m, t + 6))
    for j in range(t):
        S[:, :, j, :, j] = s.cov_tau[:, j]
    for axis in range(3):
        S[:, :, t + axis, :, t + axis] = s.cov_acc
        S[:, :, t + 3 + axis, :, t + 3 + axis] = s.cov_gyro[:, :m, :m]
    size = m * int(use.sum())
    D = by_motion(prediction)
    if not use.all():
        S, D = S[:, :, use][:, :, :, :, use], D[:, :, use]
    S = S.reshape(B, size, size)
    orders = len(D)
    joint = s.cov_joint.reshape(B, n, -1, m, s.cov_joint.shape[2] // m, m)
    S += through(s, D, joint[:, :, :orders, :, :orders]).reshape(B, size, size)
    if prediction.D_carried is not None:
        D_h, k = prediction.D_carried[:, :, use], s.cov_carried.shape[1]
        S += through(s, D_h, s.cov_carried.reshape(B, k, 2, m, 2, m)).reshape(B, size, size)
    if prediction.D_start is not None and prediction.doubt is not None and prediction.doubt.any():
        D_e = prediction.D_start[:, use].reshape(B, size, -1)
        S += (D_e * prediction.doubt[:, None]) @ D_e.transpose(0, 2, 1)
    if rate == "measured":
        D_w = np.zeros((1, B * m, t + 6, 3))
        D_w[0, :, : t + 3] = prediction.D_w
        gyro = np.repeat(s.cov_gyro[:, None, :m, :m], 3, axis=1).reshape(B, 3, 1, m, 1, m)
        S += through(s, D_w[:, :, use], gyro).reshape(B, size, size)
    return S


def by_motion(prediction: Prediction) -> FloatArray:
    """Return derivatives (2 or 3, m, t + 6, n) by qd, by qdd, and by q where angles are noisy."""
    m, rows, n = prediction.D_qd.shape
    D = np.zeros((2 if prediction.D_q is None else 3, m, rows, n))
    D[0], D[1, :, : rows - 3] = prediction.D_qd, prediction.D_qdd
    if prediction.D_q is not None:
        D[2] = prediction.D_q
    return D


def smoothed(s: BlockStack, D: FloatArray, weighted: FloatArray, by_edge: FloatArray) -> BlockStack:
    """Return the blocks with joint motion re-estimated from weighted residuals S^-1 r (N, rows).

    A Jacobian evaluated at the measured motion shares the motion's noise with the residuals,
    which shrinks the estimate; evaluated at z + Sigma D^T S^-1 r - `by_edge` it does not, with
    the share of the edge (B, n, 3 m, 1). A joint at rest stays there. Source: mrnea.py.
    """
    m, n, B = s.m, s.n, len(s.blocks)
    drawn = np.zeros((B, m, n, 3))
    drawn[..., : len(D)] = np.einsum("dkrj,kr->kjd", D, weighted).reshape(B, m, n, len(D))
    drawn = drawn.transpose(0, 2, 3, 1).reshape(B, n, 3 * m, 1)
    moves = (s.by_block(s.qd_rad_s) != 0.0).any(axis=1)  # (B, n)
    step = (
        (moves[:, :, None, None] * (s.cov_joint @ drawn - by_edge))
        .reshape(B, n, 3, m)
        .transpose(0, 2, 3, 1)
    )
    return BlockStack(
        tuple(
            replace(
                block,
                qd_rad_s=block.qd_rad_s + own[0],
                qdd_rad_s2=block.qdd_rad_s2 + own[1],
                q_rad=block.q_rad + own[2],
            )
            for block, own in zip(s.blocks, step, strict=True)
        )
    )


def through(s: BlockStack, D: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the covariance (B, m, r, m, r) of residuals by errors of (B, j, d, m, d, m).

    `D` (d, N, r, j) are sensitivities to the d-th derivatives of channel j at the same node.
    """
    d, _, r, j = D.shape
    B, m = len(s.blocks), s.m
    by_node = D.reshape(d, B, m, r, j)
    left = by_node.transpose(1, 2, 3, 0, 4).reshape(B, m, r, d * j)
    right = by_node.transpose(1, 4, 2, 0, 3)  # B, j, m, d, r
    mixed = np.zeros((B, j, d, m, m, r))
    for order in range(d):
        own = covariance[:, :, :, :, order, :, None]  # B, j, d, m, m, 1
        mixed += own * right[:, :, None, None, :, order]
    inner = mixed.transpose(0, 3, 2, 1, 4, 5).reshape(B, m, d * j, m * r)
    return (left @ inner).reshape(B, m, r, m, r)
