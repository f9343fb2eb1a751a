"""The recursive estimator: blocks in, estimates out, re-linearisation between two blocks.

A new block is folded into the square-root information at once. The rows depend on the unknowns, so
rows that were linearised at a wrong start do not give the batch solution. Therefore blocks are
stored, and passes re-linearise all of them at the current estimate, while that is expected to move
the estimate. The number of blocks re-linearised between two new ones is fixed, so that no result
depends on when the work is done.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from fsw.config import Config, EstimatorConfig
from fsw.errors import NUMERICAL, EstimatorError, unforeseen
from fsw.estimators.diagnosis import diagnose, plain
from fsw.estimators.measurement.row_functions import RowsFunction, row_function, watched_rows
from fsw.estimators.model.building import build_problem, robot_of
from fsw.estimators.model.mobility import by_mobility, is_bent
from fsw.estimators.model.problem import IMPLAUSIBLE, Problem
from fsw.estimators.model.robot import RobotModel
from fsw.estimators.reasons import Failed
from fsw.estimators.recursive.estimation import EventWords
from fsw.estimators.recursive.isolation import ChannelScreen
from fsw.estimators.recursive.outcome import WEAKEST_GAIN, outcome, weakest_gain
from fsw.estimators.recursive.recursion import Recursion
from fsw.estimators.recursive.rival import Rival, Standing
from fsw.estimators.recursive.snapshot import Values, check_fit, kept, put
from fsw.estimators.square_root import SquareRootInformation
from fsw.messages import Block, Estimate, FloatArray
from fsw.messages.false_alarms import per_test
from fsw.messages.findings import Finding

WORK_PER_BLOCK = 18  # units of re-linearisation due between two blocks
_STATE = ("_after", "_ignored", "_due")


class OnlineEstimator:
    """Recursive estimation for one problem; results depend on the blocks alone."""

    def __init__(
        self,
        problem: Problem,
        settings: EstimatorConfig,
        rows: RowsFunction,
        *,
        linear: bool,
        false_alarm: float = per_test("sensor"),
    ) -> None:
        """`false_alarm`: probability that one good channel of one block is called inconsistent."""
        self.problem, self.rows, self.linear = problem, rows, linear
        self._settings, self._false_alarm = settings, false_alarm
        self.reset()

    def reset(self) -> None:
        """Discard all blocks; return to the prior."""
        self.recursion = self._new()
        self.rival: Rival | None = None  # the estimate before a change that is not certain yet
        self._after = -1
        self._ignored = self._due = 0

    def _new(self) -> Recursion:
        screen = ChannelScreen(self.problem.model.torque_sensors, self._false_alarm)
        return Recursion(self.problem, self._settings, self.rows, screen, linear=self.linear)

    def adopt(self, result: Mapping[str, Any]) -> None:
        """Start again from a batch result: its mean and covariance become the prior.

        Blocks up to the batch's last one are ignored from now on, because its result includes them.
        With forgetting, the information of the batch's data fades like that of any other data.

        Raises
        ------
        EstimatorError if the result is for other states or not a proper estimate.
        """
        k = self.problem.published
        if tuple(result["names"]) != tuple(self.problem.names[i] for i in k):
            raise EstimatorError("the batch result is for other unknowns than the online estimator")
        if result["status"] != "OK":
            raise EstimatorError(f"the batch ended with {result['status']}; nothing adopted")
        mean, covariance = self.problem.prior_mean.copy(), self.problem.prior_covariance.copy()
        mean[k], covariance[np.ix_(k, k)] = result["mean"], result["covariance"]
        try:
            SquareRootInformation.from_prior(mean, covariance)
        except np.linalg.LinAlgError as error:
            raise EstimatorError("the batch covariance is not positive definite") from error
        self.reset()
        self._after = int(result["last_block"])
        self.recursion.take_over(mean, covariance, self._after - int(result["first_block"]) + 1)

    @property
    def blocks(self) -> tuple[Block, ...]:
        """Return the blocks a snapshot refers to, oldest first."""
        own = self.recursion.memory.blocks
        if self.rival is None:
            return own
        every = {block.index: block for block in (*self.rival.recursion.memory.blocks, *own)}
        return tuple(every[index] for index in sorted(every))

    def snapshot(self) -> dict[str, Any]:
        """Return the whole state as plain values; stored blocks by their index."""
        names = {"names": list(self.problem.names)}
        rival = None if self.rival is None else self.rival.snapshot()
        state = {"recursion": self.recursion.snapshot(), "rival": rival}
        return names | kept(self, _STATE) | state

    def restore(self, values: Values, blocks: Mapping[int, Block]) -> None:
        """Continue from a snapshot as if there had been no interruption.

        Raises
        ------
        EstimatorError if it is of another problem or a block is missing; nothing is changed then.
        """
        check_fit(self.problem, values)
        rival = None if values["rival"] is None else Rival(self._new())
        if rival is not None:
            rival.restore(values["rival"], blocks)
        self.recursion.restore(values["recursion"], blocks)
        self.rival = rival
        put(self, _STATE, values)

    def push(self, block: Block) -> Estimate:
        """Fold in one block and return the estimate after it.

        Work that is due comes first, so that the result does not depend on whether `work` was
        called. A block not newer than the newest is ignored. If arithmetic fails, the estimate
        restarts at the prior without this block, and an event says why.
        """
        self.work()
        fresh = block.index > self._after
        if fresh:
            self._after = block.index
            self._fold(block)
            self._due = 0 if self.linear else WORK_PER_BLOCK
        else:
            self._ignored += 1
        estimate = self.estimate(int(block.t_ns[-1]))
        self.recursion.armed |= fresh and estimate.valid and not self.linear
        return estimate

    def _fold(self, block: Block) -> None:
        """Fold a block in; after a change, decide whether the estimate before it still holds."""
        rival = self.rival
        try:
            if self.recursion.fold(block):
                before = self.recursion
                self.recursion = before.reopened()
                self.rival = None if before.spared else Rival(before)
        except NUMERICAL as error:
            self._begin_again(error)
        standing = Standing.OPEN if rival is None else rival.fold(block)
        if rival is not None and standing is Standing.CONFIRMED:
            rival.recursion.resume(self.recursion, rival.blocks)
            self.recursion = rival.recursion
        if standing is not Standing.OPEN:
            self.rival = None

    def screened(self, block: Block) -> Block:
        """Return the newest block without what did not fit the model; any other block unchanged."""
        used = self.recursion.used
        return block if used is None or used.index != block.index else used

    def work(self) -> None:
        """Do the re-linearisation that is due before the next block."""
        due, self._due = self._due, 0
        try:
            while due > 0 and self.recursion.has_work:
                due -= self.recursion.work(due)
            self.recursion.memory.make_one()
            if self.rival is not None:
                self.rival.recursion.memory.make_one()
        except NUMERICAL as error:
            self._begin_again(error)

    def finish(self, max_passes: int = 30) -> Estimate:
        """Re-linearise all blocks until the estimate settles; for the end of a run or a replay."""
        self.work()
        try:
            self.recursion.settle(max_passes)
        except NUMERICAL as error:
            self._begin_again(error)
        return self.estimate(self._now_ns())

    def events(self) -> list[EventWords]:
        """Return severity, code and text of the events since the last call, for an operator."""
        return self.recursion.take_events()

    def findings(self) -> list[Finding]:
        """Return and discard the findings on sensors that do not fit the model."""
        return self.recursion.screen.take()

    def report(self) -> dict[str, Any]:
        """Return a diagnosis of the current estimate as plain values.

        Raises
        ------
        EstimatorError if there is no proper covariance.
        """
        recursion = self.recursion
        try:
            estimate, k = self.estimate(self._now_ns()), self.problem.published
            diagnosis = diagnose(
                names=estimate.names,
                prior_mean=recursion.origin.mean[k],
                prior_covariance=recursion.origin.covariance[np.ix_(k, k)],
                mean=estimate.mean,
                covariance=estimate.covariance,
                bodies=estimate.bodies,
                duration_s=recursion.duration_s,
                reasons=estimate.reasons,
            )
        except NUMERICAL as error:
            raise EstimatorError("the covariance is not positive definite") from error
        correlation, bound = recursion.monitor.whiteness()
        return {
            "valid": estimate.valid,
            "reason": estimate.reason,
            "reasons": list(estimate.reasons),
            "duration_s": recursion.duration_s,
            "blocks": recursion.blocks,
            "innovation_lag1": {"correlation": correlation, "bound": bound},
            "noise_ratio": float(np.sqrt(recursion.monitor.level)),
            **recursion.noise.report(self.problem.model.torque_units, self.problem.model.n),
            **plain(diagnosis, estimate.names),
        }

    def estimate(self, t_ns: int) -> Estimate:
        """Return the published estimate of the state; restart at the prior if it is improper."""
        try:
            estimate = self._outcome(t_ns)
            if np.isfinite(estimate.mean).all() and np.isfinite(estimate.covariance).all():
                return estimate
            self._begin_again(EstimatorError("the estimate is not finite"))
        except NUMERICAL as error:
            self._begin_again(error)
        return self._outcome(t_ns)

    def _begin_again(self, error: Exception) -> None:
        words = str(error) if isinstance(error, EstimatorError) else unforeseen(error)
        self.recursion.begin_again(f"the estimate was not proper ({words})")

    def _outcome(self, t_ns: int) -> Estimate:
        recursion, monitor = self.recursion, self.recursion.monitor
        information = recursion.memory.tempered(monitor.level)
        covariance = recursion.covariance()
        weak = False
        if self.linear:  # data that fit exactly, as at rest without noise, scale sigma to 0
            prior = recursion.origin.covariance
            weak = weakest_gain(self.problem, prior, covariance) <= WEAKEST_GAIN
            covariance = covariance * recursion.residual_variance()
        condition = information.scaled_condition_number()
        if recursion.blocks and self._bent:
            covariance = self._by_mobility(covariance)
        lag, bound = monitor.whiteness()
        extra = {
            "ignored": float(self._ignored),
            "changes": float(recursion.changes),
            "noise_ratio": float(np.sqrt(monitor.level)),
            "innovation_lag1": lag,
            "innovation_lag1_bound": bound,
            "slow_residual": recursion.trust.slow[0],
            "residual_lag1": recursion.trust.colour[0],
        }
        if recursion.outside is not None:
            extra["outside"] = float(("", "base", "target").index(recursion.outside.place))
        if self.linear:
            extra["biased"] = 1.0
        return outcome(
            self.problem,
            self._settings.method,
            recursion.x,
            covariance,
            failed=self._failed(weak=weak or condition > self._settings.condition_limit),
            t_ns=t_ns,
            q_rad=recursion.q_rad,
            blocks=recursion.blocks,
            gated=recursion.gated,
            nis=monitor.nis,
            nis_dof=monitor.nis_dof,
            condition_number=condition,
            extra=extra,
            prior=recursion.origin.widened,
        )

    @property
    def _bent(self) -> bool:
        """Return whether the likelihood is Gaussian in the base's mobility instead of in pi."""
        return not self.linear and is_bent(self.problem, self._settings.method)

    def _by_mobility(self, covariance: FloatArray) -> FloatArray:
        """Return the covariance by way of the base's mobility, if it is needed and possible."""
        x, base = self.recursion.x, self.problem.body("base")
        try:
            mapped = by_mobility(x, covariance, base)
        except np.linalg.LinAlgError:  # singular to working precision
            return covariance
        return mapped.covariance if mapped.holds and mapped.bent else covariance

    def _failed(self, *, weak: bool) -> Failed:
        """Return the checks that failed; `weak`: the motion shows too little."""
        recursion, trust = self.recursion, self.recursion.trust
        least, level = self._settings.settle_blocks, recursion.monitor.level
        few, converged = recursion.since < least, recursion.pacing.settled
        scattered = trust.is_scattered(recursion.since, least)
        doubtful, changed = trust.is_doubtful(recursion.since), recursion.changes > 0
        implausible = self.problem.least_plausible(recursion.x)[1] > IMPLAUSIBLE
        return Failed(
            few_blocks=few and not (changed or scattered),
            reopened=((few or doubtful) and changed) or self.rival is not None,
            not_converged=not converged,
            misfit=scattered or (converged and trust.is_large(level)),
            mismatch=trust.mismatch(level) or implausible,
            prior_conflict=recursion.conflict or (doubtful and not changed),
            not_excited=weak,
        )

    def _now_ns(self) -> int:
        span_ns = self.recursion.span_ns
        return span_ns[1] if span_ns else 0


def build_online(config: Config, model: RobotModel | None = None) -> OnlineEstimator:
    """Build the recursive estimator of a configuration.

    The weightings ols and wls are the paper's regression, which has no prior, so their prior is
    made almost flat. Their known bodies and mounting are exact.

    Raises
    ------
    ConfigError if the robot cannot be read or does not match the joints.
    """
    if model is None:
        model = robot_of(config)
    settings = config.estimator
    linear = settings.is_regression
    problem = build_problem(config, model, exact=linear)
    rows = row_function(settings.method, settings.weighting, problem)
    if settings.method == "fused":
        rows = watched_rows(problem) or rows
    false_alarm = config.health.false_alarm_probability
    return OnlineEstimator(problem, settings, rows, linear=linear, false_alarm=false_alarm)
