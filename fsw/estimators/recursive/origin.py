"""The prior that the recursion last started from, and its epochs of angles and momentum."""

from dataclasses import replace
from typing import Any

import numpy as np

from fsw.estimators.model.problem import Problem
from fsw.estimators.recursive.epoch import Epoch, next_epoch, next_momentum
from fsw.estimators.recursive.snapshot import Values
from fsw.estimators.square_root import SquareRootInformation
from fsw.messages import Block, FloatArray

FLAT_PRIOR = 1e4  # factor on the prior's sigma for the linear weightings


class Origin:
    """Prior of the last start.

    Attributes
    ----------
    mean, covariance : (p,), (p, p); the covariance is wider where the data contradicted it
    """

    def __init__(self, problem: Problem, *, linear: bool) -> None:
        self._problem, self._linear = problem, linear
        self._walked_rad2 = np.zeros(problem.model.n)  # variance at the epoch's start
        self.mean, self.covariance = problem.prior_mean, self.stated

    @property
    def stated(self) -> FloatArray:
        """Return the configured covariance (p, p), with the walk so far added to joints' zeros."""
        covariance = self._problem.prior_covariance
        if self._walked_rad2.any():
            zeros = np.arange(len(covariance))[self._problem.at("joint_zero")]
            covariance = covariance.copy()
            covariance[zeros, zeros] += self._walked_rad2
        return FLAT_PRIOR**2 * covariance if self._linear else covariance

    @property
    def widened(self) -> FloatArray | None:
        """Return the covariance (p, p) if it was widened since the start; None: it was not."""
        wider = bool(np.any(np.diag(self.covariance) > (1.0 + 1e-9) * np.diag(self.stated)))
        return self.covariance if wider and not self._linear else None

    def information(self, x: FloatArray) -> SquareRootInformation:
        """Return the prior's information, linearised at a state (p,)."""
        return self._problem.prior_of(self.mean, self.covariance).at(x)

    def in_epoch(self, block: Block) -> Block:
        """Return the block with its walk counted from the start of the epoch."""
        if self._problem.walks is None:
            return block
        return replace(block, walk_rad2=block.walk_rad2 - self._walked_rad2)

    def follow(self, block: Block, data: SquareRootInformation) -> SquareRootInformation | None:
        """Begin a new epoch if a block is beyond the steps of the walks; else return None.

        Returns
        -------
        information of the data so far, in the states of the new epoch
        """
        walks = self._problem.walks
        if walks is None:
            return None
        beyond = block.walk_rad2 - self._walked_rad2
        if (beyond[walks.joints] <= walks.knots_rad2[:, -1]).all():
            return None
        prior = self.mean, self.covariance
        self._walked_rad2 = block.walk_rad2
        return self._begun(next_epoch(self._problem, walks, prior, data, beyond))

    def with_momentum(
        self, momentum_Nms: FloatArray, data: SquareRootInformation
    ) -> SquareRootInformation:
        """Begin an epoch with a new momentum (3,); return the data's information in its states."""
        prior = self.mean, self.covariance
        return self._begun(next_momentum(self._problem, prior, data, momentum_Nms))

    def _begun(self, epoch: Epoch) -> SquareRootInformation:
        self.mean, self.covariance = epoch.mean, epoch.covariance
        return epoch.data

    def snapshot(self) -> dict[str, Any]:
        """Return the state as plain values."""
        values = {"start_mean": self.mean.copy(), "start_covariance": self.covariance.copy()}
        if self._problem.walks is not None:
            values["walked"] = self._walked_rad2.copy()
        return values

    def restore(self, values: Values) -> None:
        """Continue from a snapshot."""
        self.mean, self.covariance = values["start_mean"].copy(), values["start_covariance"].copy()
        if self._problem.walks is not None:
            self._walked_rad2 = np.asarray(values["walked"])
