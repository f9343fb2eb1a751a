"""The recursive estimator: a bounded store of blocks, re-linearised until it stops moving.

A new block is folded into the square-root information at once. Because the rows depend on the
unknowns, one pass linearised at a wrong start is not the batch; so the blocks are kept, and a
background pass re-linearises them all at the current estimate, one block per unit of work. While
the estimate moves by more than a tolerance per pass nothing is published as valid; afterwards
passes run only when it has drifted. A block that leaves the full store stays in the information
with its newest linearisation, so memory is bounded and nothing is counted twice.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.special import chdtri

from fsw.config import Config, EstimatorConfig
from fsw.errors import EstimatorError
from fsw.estimators.fused import fused_rows
from fsw.estimators.inertia import (
    PARAMETERS,
    is_consistent,
    nearest_consistent,
)
from fsw.estimators.model import RobotModel
from fsw.estimators.mrnea import Rows, mrnea_rows
from fsw.estimators.problem import Problem, build_problem
from fsw.estimators.publish import body_estimate, whole_estimate
from fsw.estimators.square_root import SquareRootInformation
from fsw.messages import Block, Estimate, FloatArray

SETTLED = 0.02  # whitened rms step of a whole pass below which the estimate has settled
WORK_PER_BLOCK = 16  # units of background work due between two blocks
INCONSISTENT = 1e-3  # probability of so large a projection onto the consistent bodies by noise
FLAT_PRIOR = 1e4  # factor on the prior's sigma for the linear weightings

RowsFunction = Callable[[Block, FloatArray], Rows]


@dataclass(slots=True, eq=False)
class _Stored:
    """A block with its newest whitened rows, as A x = c."""

    block: Block
    A: FloatArray
    c: FloatArray


class OnlineEstimator:
    """Recursive estimation for one problem; results depend on the blocks alone."""

    def __init__(
        self,
        problem: Problem,
        settings: EstimatorConfig,
        rows: RowsFunction,
        *,
        linear: bool,
    ) -> None:
        self._problem = problem
        self._settings = settings
        self._rows = rows
        self._linear = linear
        self.reset()

    def reset(self) -> None:
        """Forget all blocks; return to the prior."""
        problem = self._problem
        prior = SquareRootInformation.from_prior(problem.prior_mean, problem.prior_covariance)
        self._retired = prior
        self._information = prior
        self._x = problem.prior_mean.copy()
        self._store: deque[_Stored] = deque()
        self._pass: SquareRootInformation | None = None
        self._pass_x = self._x
        self._pass_total = 0
        self._visited = 0
        self._due = 0
        self._settled = self._linear
        self._passes = 0
        self._blocks = 0
        self._gated = 0
        self._nis = (0.0, 0)
        self._q_rad: FloatArray | None = None
        self._after = -1

    def adopt(self, result: Mapping[str, Any]) -> None:
        """Start again from a batch result: its mean and covariance become the prior.

        Blocks up to the batch's last one are ignored from now on; they are in its result already.

        Raises
        ------
        EstimatorError if the result is for other states or not a proper estimate.
        """
        if tuple(result["names"]) != self._problem.names:
            raise EstimatorError("the batch result is for other unknowns than the online estimator")
        if result["status"] != "OK":
            raise EstimatorError(f"the batch ended with {result['status']}; nothing adopted")
        mean, covariance = np.array(result["mean"]), np.array(result["covariance"])
        try:
            prior = SquareRootInformation.from_prior(mean, covariance)
        except np.linalg.LinAlgError as error:
            raise EstimatorError("the batch covariance is not positive definite") from error
        self.reset()
        self._retired = self._information = prior
        self._x = self._pass_x = mean
        self._after = int(result["last_block"])
        self._blocks = self._after - int(result["first_block"]) + 1
        self._settled = True

    def push(self, block: Block) -> Estimate:
        """Fold in one block and return the estimate after it.

        Background work that is due is finished first, so that the result does not depend on how
        often `work` was called in between.
        """
        while self.work():
            pass
        if block.index > self._after:
            self._q_rad = block.q_rad[-1]
            self._fold(block)
        self._due = 0 if self._linear else WORK_PER_BLOCK
        return self.estimate(int(block.t_ns[-1]))

    def work(self) -> bool:
        """Re-linearise at most one stored block; True while more is due before the next block."""
        if self._due <= 0 or not self._store:
            return False
        if self._pass is None and self._settled and self._drift() < SETTLED:
            self._due = 0
            return False
        self._advance_pass()
        self._due -= 1
        return self._due > 0

    def finish(self, max_passes: int = 30) -> Estimate:
        """Re-linearise everything until it has settled; for the end of a run or a replay."""
        if not self._linear and self._store:
            start = self._passes
            while self._passes - start < max_passes:
                if self._pass is None and self._settled and self._drift() < SETTLED / 10:
                    break
                self._advance_pass()
        t_ns = int(self._store[-1].block.t_ns[-1]) if self._store else 0
        return self.estimate(t_ns)

    def estimate(self, t_ns: int) -> Estimate:
        """Return the published view of the current state."""
        problem = self._problem
        try:
            covariance = self._information.covariance()
            condition = self._information.scaled_condition_number()
        except EstimatorError:
            self.reset()
            covariance, condition = problem.prior_covariance, float("inf")
        reason = self._reason(condition)
        bodies = {}
        for name in problem.unknown:
            bodies[name], distance = body_estimate(problem, name, self._x, covariance)
            if not reason and distance > chdtri(PARAMETERS, INCONSISTENT):
                reason = "NOT_CONSISTENT"
        whole = None
        if self._q_rad is not None:
            whole = whole_estimate(problem, self._x, covariance, self._q_rad)
        k = problem.bodies
        gained = 0.5 * (
            np.linalg.slogdet(problem.prior_covariance[k, k])[1]
            - np.linalg.slogdet(covariance[k, k])[1]
        )
        return Estimate(
            t_ns=t_ns,
            valid=not reason,
            reason=reason,
            method=self._settings.method,
            names=problem.names,
            mean=self._x.copy(),
            covariance=covariance,
            bodies=bodies,
            blocks=self._blocks,
            gated=self._gated,
            nis=self._nis[0],
            nis_dof=self._nis[1],
            condition_number=condition,
            information_gained_nats=float(gained),
            whole=whole,
        )

    def _reason(self, condition: float) -> str:
        if self._blocks < self._settings.settle_blocks:
            return "TOO_FEW_BLOCKS"
        if not self._settled:
            return "NOT_CONVERGED"
        if condition > self._settings.condition_limit:
            return "INSUFFICIENT_EXCITATION"
        return ""

    def _fold(self, block: Block) -> None:
        at = self._linearisation_point()
        rows = self._rows(block, at)
        if not (np.all(np.isfinite(rows.A)) and np.all(np.isfinite(rows.b))):
            self._gated += 1
            return
        innovation = rows.b - rows.A @ (self._x - at)
        self._nis = self._innovation(rows.A, innovation)
        if self._settled and not self._linear and self._blocks >= self._settings.settle_blocks:
            limit = chdtri(self._nis[1], self._settings.gate_probability)
            if self._nis[0] > limit:
                self._gated += 1
                return
        stored = _Stored(block, rows.A, rows.b + rows.A @ at)
        self._blocks += 1
        self._information = self._information.update(stored.A, stored.c)
        if self._pass is not None:
            self._pass = self._pass.update(stored.A, stored.c)
        if self._linear:
            self._retired = self._information
        else:
            self._store.append(stored)
            if len(self._store) > self._settings.store_blocks:
                self._retire()
        self._solve()

    def _retire(self) -> None:
        oldest = self._store.popleft()
        self._retired = self._retired.update(oldest.A, oldest.c)
        if self._pass is not None:
            if self._visited > 0:
                self._visited -= 1
            else:
                self._pass = self._pass.update(oldest.A, oldest.c)
                self._pass_total -= 1

    def _solve(self) -> None:
        try:
            self._x = self._information.mean()
        except EstimatorError:
            self.reset()

    def _begin_pass(self) -> SquareRootInformation:
        self._pass = self._retired
        self._pass_x = self._linearisation_point()
        self._visited = 0
        self._pass_total = len(self._store)
        return self._pass

    def _advance_pass(self) -> None:
        """Re-linearise the next stored block; blocks come since are in the pass already."""
        information = self._begin_pass() if self._pass is None else self._pass
        stored = self._store[self._visited]
        rows = self._rows(stored.block, self._pass_x)
        if np.all(np.isfinite(rows.A)) and np.all(np.isfinite(rows.b)):
            stored.A, stored.c = rows.A, rows.b + rows.A @ self._pass_x
        self._pass = information.update(stored.A, stored.c)
        self._visited += 1
        if self._visited >= self._pass_total:
            self._information, self._pass = self._pass, None
            self._passes += 1
            self._solve()
            self._settled = self._drift() < SETTLED

    def _drift(self) -> float:
        """Whitened rms distance of the estimate from the point of the last pass."""
        step = self._information.R @ (self._x - self._pass_x)
        return float(np.sqrt(step @ step / len(step)))

    def _linearisation_point(self) -> FloatArray:
        """Return the estimate with every body moved to the nearest physically consistent one."""
        if self._linear:
            return self._problem.prior_mean
        x = self._x
        for name in self._problem.unknown:
            k = self._problem.body(name)
            if not is_consistent(x[k]):
                if x is self._x:
                    x = self._x.copy()
                covariance = self._information.covariance()[k, k]
                x[k] = nearest_consistent(x[k], covariance)
        return x

    def _innovation(self, A: FloatArray, innovation: FloatArray) -> tuple[float, int]:
        """Return the normalised innovation squared and its degrees of freedom."""
        AS = A @ self._information.covariance_root()
        S = np.eye(len(innovation)) + AS @ AS.T
        return float(innovation @ np.linalg.solve(S, innovation)), len(innovation)


def build_online(config: Config, model: RobotModel | None = None) -> OnlineEstimator:
    """Build the recursive estimator of a configuration.

    The linear weightings are the paper's regression, which has no prior: theirs is made flat.

    Raises
    ------
    ConfigError if the robot cannot be read or does not match the joints.
    """
    if model is None:
        model = RobotModel(config.resolve(config.robot.urdf), config.robot.tool_frame)
    problem = build_problem(config, model)
    settings = config.estimator
    if settings.method == "fused":
        return OnlineEstimator(
            problem, settings, partial(fused_rows, problem=problem), linear=False
        )
    linear = settings.weighting != "eiv"
    if linear:
        flat = FLAT_PRIOR**2 * problem.prior_covariance
        problem = replace(problem, prior_covariance=flat)
    rows = partial(mrnea_rows, problem=problem, weighting=settings.weighting)
    return OnlineEstimator(problem, settings, rows, linear=linear)
