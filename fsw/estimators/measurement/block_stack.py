"""Stacks of blocks of one kind, so that a measurement model is evaluated over all their nodes.

A stack has the attributes of a block. Values at nodes have the nodes of all blocks one after the
other; covariances have an additional first axis over the blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from fsw.estimators.effects.joint_torque import JointMotion
from fsw.messages import PARTS, Block, FloatArray


def covariance_root(covariance: FloatArray) -> FloatArray:
    """Return F (..., k, k) with F F^T = covariance (..., k, k), which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    root: FloatArray = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return root


def kind_of(block: Block) -> tuple[object, ...]:
    """Return a key that blocks of one stack have in common: shapes and usable channels."""
    usable = (block.has_gyro, block.has_accelerometer, block.has_attitude)
    shapes = (block.q_rad.shape, block.cov_joint.shape)
    parts = [getattr(block, names[-1]).shape for names in PARTS]
    return (shapes, block.has_joint.tobytes(), usable, *parts)


def stacks_of(blocks: Sequence[Block]) -> list[BlockStack]:
    """Return the blocks in order as stacks: each holds neighbours of one kind."""
    return [BlockStack(tuple(own)) for _, own in groupby(blocks, kind_of)]


class BlockStack:
    """B blocks of m nodes each, N = B m.

    Attributes
    ----------
    q_rad, qd_rad_s, qdd_rad_s2 : (N, n)
    tau_nm : (N, t), torques of joints, then the axes of wrench sensors
    w_NB_B_rad_s, wd_NB_B_rad_s2, f_NS_B_m_s2 : (N, 3)
    R_NB : (N, 3, 3)
    cov_joint : (B, n, 2 m, 2 m) or (B, n, 3 m, 3 m)
    cov_tau : (B, t, m, m)
    cov_gyro, cov_acc : (B, 2 m, 2 m), (B, m, m)
    carried_nms, carried_nm : (N, k), momentum of k parts of the base, and its derivative
    cov_carried : (B, k, 2 m, 2 m)
    """

    def __init__(self, blocks: tuple[Block, ...]) -> None:
        self.blocks = blocks
        first = blocks[0]
        self.m, self.n = first.q_rad.shape
        self.t = first.tau_nm.shape[1]
        self.has_joint: NDArray[np.bool_] = first.has_joint
        self.has_gyro = first.has_gyro
        self.has_accelerometer = first.has_accelerometer
        self.has_attitude = first.has_attitude
        self.is_complete = first.is_complete
        self.q_rad = _joined([block.q_rad for block in blocks])
        self.qd_rad_s = _joined([block.qd_rad_s for block in blocks])
        self.qdd_rad_s2 = _joined([block.qdd_rad_s2 for block in blocks])
        self.tau_nm = _joined([block.tau_nm for block in blocks])
        self.w_NB_B_rad_s = _joined([block.w_NB_B_rad_s for block in blocks])
        self.wd_NB_B_rad_s2 = _joined([block.wd_NB_B_rad_s2 for block in blocks])
        self.f_NS_B_m_s2 = _joined([block.f_NS_B_m_s2 for block in blocks])
        self.R_NB = _joined([block.R_NB for block in blocks])
        self.carried_nms = _joined([block.carried_nms for block in blocks])
        self.carried_nm = _joined([block.carried_nm for block in blocks])

    @cached_property
    def cov_joint(self) -> FloatArray:
        """Covariance of the joints' motion; shapes as in `Block`, after an axis of blocks."""
        return _stacked([block.cov_joint for block in self.blocks])

    @cached_property
    def cov_tau(self) -> FloatArray:
        """Covariance of the torques."""
        return _stacked([block.cov_tau for block in self.blocks])

    @cached_property
    def cov_gyro(self) -> FloatArray:
        """Covariance of rate and angular acceleration."""
        return _stacked([block.cov_gyro for block in self.blocks])

    @cached_property
    def cov_acc(self) -> FloatArray:
        """Covariance of the specific force."""
        return _stacked([block.cov_acc for block in self.blocks])

    @cached_property
    def cov_carried(self) -> FloatArray:
        """Covariance of the momentum of parts of the base and its derivative."""
        return _stacked([block.cov_carried for block in self.blocks])

    @cached_property
    def root_rates(self) -> FloatArray:
        """Root of the covariance (B, n, 2m, 2m) of joint rates and accelerations alone."""
        size = 2 * self.m
        return covariance_root(self.cov_joint[:, :, :size, :size])

    @cached_property
    def root_gyro(self) -> FloatArray:
        """Root of `cov_gyro`, of the same shape."""
        return covariance_root(self.cov_gyro)

    @cached_property
    def root_acc(self) -> FloatArray:
        """Root of `cov_acc`, of the same shape."""
        return covariance_root(self.cov_acc)

    @property
    def has_angles(self) -> bool:
        """Return whether the blocks give the covariance of angles besides that of rates."""
        return bool(self.blocks[0].cov_joint.shape[1] == 3 * self.m)

    @cached_property
    def walk_rad2(self) -> FloatArray:
        """Variance (B, n) of the walks of integrated angles at the start of the windows."""
        return _stacked([block.walk_rad2 for block in self.blocks])

    @property
    def walks_at_nodes(self) -> FloatArray:
        """The variance `walk_rad2` at every node (N, n)."""
        return np.repeat(self.walk_rad2, self.m, axis=0)

    def shifted(self, by_rad: FloatArray) -> BlockStack:
        """Return the same blocks with the joints' angles changed, by a constant (n,) or (N, n)."""
        return self.moved(self.q_rad + by_rad, self.qd_rad_s, self.qdd_rad_s2)

    def scaled(self, by: FloatArray) -> BlockStack:
        """Return the same blocks with angles, rates and accelerations of the joints times (n,)."""
        return self.moved(self.q_rad * by, self.qd_rad_s * by, self.qdd_rad_s2 * by)

    def moved(self, q_rad: FloatArray, qd_rad_s: FloatArray, qdd_rad_s2: FloatArray) -> BlockStack:
        """Return the same blocks with other motion (N, n) of the joints."""
        other = copy(self)
        other.q_rad, other.qd_rad_s, other.qdd_rad_s2 = q_rad, qd_rad_s, qdd_rad_s2
        return other

    def turning(self, w_NB_B_rad_s: FloatArray) -> BlockStack:
        """Return the same blocks with another measured rate (N, 3)."""
        other = copy(self)
        other.w_NB_B_rad_s = w_NB_B_rad_s
        return other

    def noise_through(self, back: FloatArray) -> BlockStack:
        """Return the same blocks with the noise of each channel (t + 6) mapped by (m, m)."""
        other, M_f, M_w = copy(self), back[-4], np.kron(np.eye(2), back[-1])
        other.cov_tau = back[: self.t] @ self.cov_tau @ back[: self.t].transpose(0, 2, 1)
        other.cov_acc, other.cov_gyro = M_f @ self.cov_acc @ M_f.T, M_w @ self.cov_gyro @ M_w.T
        return other

    def doubted(self, by_rad2: FloatArray) -> BlockStack:
        """Return the same blocks with variance (B, n) of noisy angles added, common to nodes."""
        other, of_angles = copy(self), slice(2 * self.m, 3 * self.m)
        other.cov_joint = self.cov_joint.copy()
        other.cov_joint[:, :, of_angles, of_angles] += by_rad2[:, :, None, None]
        return other

    @property
    def joint_motion(self) -> JointMotion:
        """The joints' motion at the nodes, block by block."""
        return JointMotion(
            *(self.by_block(v) for v in (self.q_rad, self.qd_rad_s, self.qdd_rad_s2))
        )

    def accelerated(self, qdd_rad_s2: FloatArray) -> JointMotion:
        """Return the joints' motion with other accelerations (N, n)."""
        return replace(self.joint_motion, qdd_rad_s2=self.by_block(qdd_rad_s2))

    def by_block(self, values: FloatArray) -> FloatArray:
        """Return values at the nodes (N, ...) as (B, m, ...)."""
        return values.reshape(len(self.blocks), self.m, *values.shape[1:])


def _joined(parts: list[FloatArray]) -> FloatArray:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _stacked(parts: list[FloatArray]) -> FloatArray:
    return parts[0][None] if len(parts) == 1 else np.stack(parts)
