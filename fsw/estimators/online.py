"""The recursive estimator: a bounded store of blocks, re-linearised until it stops moving.

A new block is folded into the square-root information at once. Because the rows depend on the
unknowns, one pass linearised at a wrong start is not the batch; so the blocks are kept, and a
background pass re-linearises them all at the current estimate, one block per unit of work. Passes
run while they are expected to move the estimate; what moves it otherwise is data. A run of blocks
that noise does not explain re-opens the estimate to the prior's spread; a prior that the data
contradict is widened. Both are told as events.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from fsw.config import Config, EstimatorConfig
from fsw.errors import EstimatorError
from fsw.estimators.bias_compensated import BiasCompensatedEstimator
from fsw.estimators.change import InnovationMonitor, slow_power
from fsw.estimators.diagnosis import conflict_limit, diagnose, plain, prior_conflict
from fsw.estimators.impulse import Impulse
from fsw.estimators.inertia import is_consistent, nearest_consistent
from fsw.estimators.isolation import ChannelScreen
from fsw.estimators.memory import Memory, data_within
from fsw.estimators.model import RobotModel
from fsw.estimators.mrnea import Rows
from fsw.estimators.outcome import outcome
from fsw.estimators.pacing import SETTLED, Pacing
from fsw.estimators.plausible import plausible
from fsw.estimators.problem import Problem, build_problem
from fsw.estimators.row_functions import RowsFunction, row_function
from fsw.estimators.snapshot import Values, check_fit, kept, put, to_information
from fsw.estimators.square_root import SquareRootInformation
from fsw.findings import Finding
from fsw.messages import Block, Estimate, FloatArray

WORK_PER_BLOCK = 16  # units of background work due between two blocks
LEVEL_BLOCKS = 64  # newest blocks that tell the noise level
MISMATCH_LEVEL = 9.0  # noise variance over the declared one that no sensor's noise explains
FLAT_PRIOR = 1e4  # factor on the prior's sigma for the linear weightings
ABSURD = 1e12  # normalised innovation squared over its degrees of freedom, settled or not
EVENT_LIMIT = 64

_STATE = (
    *("_changes", "_blocks", "_gated", "_ignored", "_q_rad", "_after", "_span_ns"),
    *("_start_mean", "_start_covariance", "_x", "_since", "_armed", "_conflict", "_check_due"),
    *("_due", "_rss"),
)

EventWords = tuple[str, str, str]  # severity, code, text


class OnlineEstimator:
    """Recursive estimation for one problem; results depend on the blocks alone."""

    def __init__(
        self,
        problem: Problem,
        settings: EstimatorConfig,
        rows: RowsFunction,
        *,
        linear: bool,
        false_alarm: float = 1e-9,
    ) -> None:
        """`false_alarm`: probability of calling one channel of one block inconsistent."""
        self._problem = problem
        self._false_alarm = false_alarm
        self._settings = settings
        self._rows = rows
        self._linear = linear
        self._events: deque[EventWords] = deque(maxlen=EVENT_LIMIT)
        self.reset()

    def reset(self) -> None:
        """Forget all blocks; return to the prior."""
        self._changes = self._blocks = self._gated = self._ignored = 0
        self._monitor = InnovationMonitor(self._settings.gate_probability)
        self._screen = ChannelScreen(self._problem.model.joint_names, self._false_alarm)
        self._q_rad: FloatArray | None = None
        self._after = -1
        self._span_ns: tuple[int, int] | None = None  # of the blocks since the prior
        self._start(self._problem.prior_mean, self._spread())

    def _start(self, mean: FloatArray, covariance: FloatArray) -> None:
        """Begin again at a prior; counters and what is known of the sensors stay."""
        self._start_mean, self._start_covariance = mean, covariance
        prior = SquareRootInformation.from_prior(mean, covariance)
        self._store = Memory(prior, self._settings.store_blocks)
        self._x = mean.copy()
        self._since = 0  # blocks folded in since this start
        self._pacing = Pacing(settled=self._linear)
        self._armed = False  # whether blocks are gated: from the first valid estimate on
        self._conflict = False
        self._slow = (1.0, float("inf"))  # slow power of the residuals and its limit
        self._check_due = False
        self._due = 0
        self._rss = 0.0
        self._span_ns = None

    def _spread(self) -> FloatArray:
        covariance = self._problem.prior_covariance
        return FLAT_PRIOR**2 * covariance if self._linear else covariance

    def adopt(self, result: Mapping[str, Any]) -> None:
        """Start again from a batch result: its mean and covariance become the prior.

        Blocks up to the batch's last one are ignored from now on; they are in its result already.
        With forgetting, what the batch's data said is forgotten like any other data.

        Raises
        ------
        EstimatorError if the result is for other states or not a proper estimate.
        """
        problem = self._problem
        if tuple(result["names"]) != problem.names:
            raise EstimatorError("the batch result is for other unknowns than the online estimator")
        if result["status"] != "OK":
            raise EstimatorError(f"the batch ended with {result['status']}; nothing adopted")
        mean, covariance = np.array(result["mean"]), np.array(result["covariance"])
        try:
            SquareRootInformation.from_prior(mean, covariance)
        except np.linalg.LinAlgError as error:
            raise EstimatorError("the batch covariance is not positive definite") from error
        self.reset()
        if self._settings.forgetting_time_s is None:
            self._start(mean, covariance)
        else:
            prior = self._store.prior
            self._store.restart(prior, data_within(prior, mean, covariance))
            self._x = mean
        self._store.at = mean
        self._after = int(result["last_block"])
        self._blocks = self._since = self._after - int(result["first_block"]) + 1
        self._pacing.settled = True

    @property
    def blocks(self) -> tuple[Block, ...]:
        """Return the blocks a snapshot refers to, oldest first."""
        return self._store.blocks

    def snapshot(self) -> dict[str, Any]:
        """Return the whole state as plain values; stored blocks by their index."""
        return kept(self, _STATE) | {
            "kind": "online",
            "names": list(self._problem.names),
            "monitor": self._monitor.snapshot(),
            "pacing": self._pacing.snapshot(),
            "memory": self._store.snapshot(),
        }

    def restore(self, values: Values, blocks: Mapping[int, Block]) -> None:
        """Continue from a snapshot as if nothing had happened since.

        Raises
        ------
        EstimatorError if it is of another problem or a block is missing; nothing has changed then.
        """
        check_fit(self._problem, "online", values)
        prior = to_information(values["memory"]["prior"])
        store = Memory(prior, self._settings.store_blocks)
        store.restore(values["memory"], blocks, self._usable_rows)
        self._store = store
        put(self, _STATE, values)
        self._monitor.restore(values["monitor"])
        self._pacing.restore(values["pacing"])

    def push(self, block: Block) -> Estimate:
        """Fold in one block and return the estimate after it.

        Background work that is due is finished first, so that the result does not depend on how
        often `work` was called in between. A block not newer than the newest is ignored.
        """
        while self.work():
            pass
        if block.index > self._after:
            self._fold(block)
            self._due = 0 if self._linear else WORK_PER_BLOCK
        else:
            self._ignored += 1
        estimate = self.estimate(int(block.t_ns[-1]))
        self._armed = self._armed or (estimate.valid and not self._linear)
        return estimate

    def work(self) -> bool:
        """Re-linearise at most one stored block; True while more is due before the next block."""
        if self._due <= 0 or not len(self._store):
            self._store.make_one()
            return False
        if self._check_due:
            self._check_prior()
        elif self._store.in_pass or self._pacing.is_worth_a_pass(self._drift(), self._since):
            self._advance_pass()
        else:
            self._due = 0
            return False
        self._due -= 1
        return self._due > 0

    def finish(self, max_passes: int = 30) -> Estimate:
        """Re-linearise everything until it has settled; for the end of a run or a replay."""
        if not self._linear and len(self._store):
            limit = self._store.passes + max_passes
            while self._store.passes < limit:
                if self._check_due:
                    self._check_prior()
                rests = self._pacing.settled and not self._store.in_pass
                if rests and self._drift() < SETTLED / 10:
                    break
                self._advance_pass()
            if self._check_due:
                self._check_prior()
        return self.estimate(self._span_ns[1] if self._span_ns else 0)

    def events(self) -> list[EventWords]:
        """Return what an operator should know since the last call: severity, code, text."""
        drained = list(self._events)
        self._events.clear()
        return drained

    def findings(self) -> list[Finding]:
        """Return and forget which sensors were found not to fit the model."""
        return self._screen.take()

    def report(self) -> dict[str, Any]:
        """Diagnose the current estimate on demand; plain values.

        Raises
        ------
        EstimatorError if there is no proper covariance.
        """
        try:
            estimate = self.estimate(self._span_ns[1] if self._span_ns else 0)
            diagnosis = diagnose(
                names=self._problem.names,
                prior_mean=self._start_mean,
                prior_covariance=self._start_covariance,
                mean=self._x,
                covariance=estimate.covariance,
                bodies=estimate.bodies,
                duration_s=self._duration_s(),
            )
        except np.linalg.LinAlgError as error:
            raise EstimatorError("the covariance is not positive definite") from error
        correlation, bound = self._monitor.whiteness()
        return {
            "valid": estimate.valid,
            "reason": estimate.reason,
            "duration_s": self._duration_s(),
            "blocks": self._blocks,
            "innovation_lag1": {"correlation": correlation, "bound": bound},
            "noise_ratio": float(np.sqrt(self._monitor.level)),
            **plain(diagnosis, self._problem.names),
        }

    def estimate(self, t_ns: int) -> Estimate:
        """Return the published view of the current state; start over if it is not proper."""
        try:
            return self._outcome(t_ns)
        except (EstimatorError, np.linalg.LinAlgError) as error:
            self._begin_again(f"the estimate was not proper ({error})")
            return self._outcome(t_ns)

    def _outcome(self, t_ns: int) -> Estimate:
        monitor = self._monitor
        information = self._store.tempered(monitor.level)
        covariance = information.covariance()
        if self._linear:
            covariance = covariance * self._residual_variance()
        condition = information.scaled_condition_number()
        lag, bound = monitor.whiteness()
        extra = {
            "ignored": float(self._ignored),
            "changes": float(self._changes),
            "noise_ratio": float(np.sqrt(monitor.level)),
            "innovation_lag1": lag,
            "innovation_lag1_bound": bound,
            "slow_residual": self._slow[0],
        }
        if self._linear:
            extra["biased"] = 1.0
        return outcome(
            self._problem,
            self._settings.method,
            self._x,
            covariance,
            reason=self._reason(condition),
            t_ns=t_ns,
            q_rad=self._q_rad,
            blocks=self._blocks,
            gated=self._gated,
            nis=monitor.nis,
            nis_dof=monitor.nis_dof,
            condition_number=condition,
            extra=extra,
        )

    def _reason(self, condition: float) -> str:
        if self._since < self._settings.settle_blocks:
            return "REOPENED" if self._changes else "TOO_FEW_BLOCKS"
        if not self._pacing.settled:
            return "NOT_CONVERGED"
        if self._monitor.level > MISMATCH_LEVEL or self._slow[0] > self._slow[1]:
            return "MODEL_MISMATCH"
        if self._conflict:
            return "PRIOR_CONFLICT"
        if condition > self._settings.condition_limit:
            return "INSUFFICIENT_EXCITATION"
        return ""

    def _fold(self, block: Block) -> None:
        self._after = block.index
        at = self._linearisation_point()
        rows = self._usable_rows(block, at, self._store.gained)
        if rows is None:
            self._gated += 1
            return
        if self._armed:
            used = self._screen.judge(
                block,
                rows,
                self._x - at,
                self._store.information.covariance_root(),
                self._monitor.level,
            )
            if used is not block:
                block, rows = used, self._usable_rows(used, at, self._store.gained)
                if rows is None:
                    self._gated += 1
                    return
        end_ns = int(block.t_ns[-1])
        self._age(end_ns)
        white = self._whitened(rows.A, rows.b - rows.A @ (self._x - at))
        judgement = self._monitor.judge(white, armed=self._armed)
        if self._monitor.nis > ABSURD * len(white):
            self._gated += 1
            return
        self._q_rad = block.q_rad[-1]
        if not judgement.accepted:
            self._gated += 1
        else:
            self._absorb(block, rows, at, end_ns)
        if judgement.changed:
            self._reopen()

    def _absorb(self, block: Block, rows: Rows, at: FloatArray, end_ns: int) -> None:
        c = rows.b + rows.A @ at
        before, R = self._x, self._store.information.R
        self._store.add(block, rows, at, keep=not self._linear)
        self._blocks += 1
        self._since += 1
        self._span_ns = (self._span_ns[0] if self._span_ns else int(block.t_ns[0]), end_ns)
        self._solve()
        residual, step = c - rows.A @ self._x, R @ (self._x - before)
        self._rss += float(residual @ residual + step @ step)

    def _age(self, end_ns: int) -> None:
        time_s = self._settings.forgetting_time_s
        if time_s is not None and self._span_ns is not None:
            elapsed_s = max(0, end_ns - self._span_ns[1]) * 1e-9
            self._store.age(float(np.exp(-0.5 * elapsed_s / time_s)))

    def _usable_rows(self, block: Block, at: FloatArray, before: Impulse | None) -> Rows | None:
        """Return the rows; None if the block is absurd or the base has no inertia there."""
        if not plausible(block):
            return None
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            try:
                rows = self._rows(block, at, before)
            except ValueError:  # LinAlgError, or scipy's check of what it is given
                return None
        if not (np.all(np.isfinite(rows.A)) and np.all(np.isfinite(rows.b))):
            return None
        return rows

    def _solve(self) -> None:
        try:
            self._x = self._store.information.mean()
        except EstimatorError as error:
            self._begin_again(str(error))

    def _begin_again(self, why: str) -> None:
        self._start(self._problem.prior_mean, self._spread())
        self._monitor.restart()
        self._events.append(("high", "ESTIMATOR_RESET", why))

    def _reopen(self) -> None:
        mean, blocks = self._linearisation_point(), self._since
        self._changes += 1
        self._start(mean, self._spread())
        self._monitor.restart()
        text = f"the innovations no longer fit the {blocks} blocks before; estimate re-opened"
        self._events.append(("medium", "CHANGE_DETECTED", text))

    def _advance_pass(self) -> None:
        store = self._store
        if not store.in_pass:
            previous = store.at
            point = self._pacing.point(self._linearisation_point(), previous)
            self._pacing.begin(_rms(store.information.R @ (point - previous)), self._since)
            store.begin(point)
        x, R = self._x, store.information.R
        if not store.advance(self._usable_rows):
            return
        self._solve()
        if store is not self._store:  # started over
            return
        step = max(_rms(R @ (self._x - x)), _rms(store.information.R @ (self._x - x)))
        self._pacing.end(step, store.failed)
        self._check_due = self._pacing.settled
        self._learn_level()

    def _learn_level(self) -> None:
        known = self._monitor.level
        levels, dof = self._store.residual_levels(self._x, LEVEL_BLOCKS)
        self._monitor.learn_level(levels, dof, len(self._x) if self._since <= LEVEL_BLOCKS else 0)
        self._slow = slow_power(self._store.residuals(self._x), self._monitor.level)
        if self._pacing.settled and self._monitor.level > 1.0 and known == 1.0:
            ratio = np.sqrt(self._monitor.level)
            text = (
                f"residuals are {ratio:.2f} times the declared noise; sigmas follow the residuals"
            )
            self._events.append(("medium", "NOISE_ABOVE_DECLARED", text))

    def _check_prior(self) -> None:
        """Widen a prior that the data contradict, and have the estimate settle anew."""
        self._check_due = False
        covariance = self._store.tempered(self._monitor.level).covariance()
        distance, dof = prior_conflict(
            self._start_mean, self._start_covariance, self._x, covariance
        )
        self._conflict = distance > conflict_limit(dof)
        if not self._conflict:
            return
        factor = distance / dof
        self._start_covariance = factor * self._start_covariance
        self._store.replace_prior(
            SquareRootInformation.from_prior(self._start_mean, self._start_covariance)
        )
        self._solve()
        self._pacing.settled = False
        text = (
            f"the data lie {np.sqrt(factor):.1f} sigma (rms) from the prior; "
            f"its sigmas are widened by that factor"
        )
        self._events.append(("medium", "PRIOR_CONFLICT", text))

    def _drift(self) -> float:
        """Whitened rms distance of the estimate from the point of the last pass."""
        return _rms(self._store.information.R @ (self._x - self._store.at))

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
                covariance = self._store.information.covariance()[k, k]
                x[k] = nearest_consistent(x[k], covariance)
        return x

    def _whitened(self, A: FloatArray, innovation: FloatArray) -> FloatArray:
        """Return the innovation whitened by its own covariance."""
        AS = A @ self._store.information.covariance_root()
        L = np.linalg.cholesky(np.eye(len(innovation)) + AS @ AS.T)
        white: FloatArray = np.linalg.solve(L, innovation)
        return white

    def _residual_variance(self) -> float:
        """Return the residual variance of the linear regression, at least its degrees allow."""
        spare = self._store.rows - len(self._x)
        return self._rss / spare if spare > 0 else 1.0

    def _duration_s(self) -> float:
        return (self._span_ns[1] - self._span_ns[0]) * 1e-9 if self._span_ns else 0.0


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(values @ values / len(values)))


def build_online(
    config: Config, model: RobotModel | None = None
) -> OnlineEstimator | BiasCompensatedEstimator:
    """Build the recursive estimator of a configuration.

    The weightings ols and wls are the paper's regression, which has no prior: theirs is made flat.

    Raises
    ------
    ConfigError if the robot cannot be read or does not match the joints.
    """
    if model is None:
        model = RobotModel(config.resolve(config.robot.urdf), config.robot.tool_frame)
    problem = build_problem(config, model)
    settings = config.estimator
    if settings.method == "mrnea" and settings.weighting == "bc":
        return BiasCompensatedEstimator(problem, settings)
    rows = row_function(settings.method, settings.weighting, problem)
    linear = settings.method == "mrnea" and settings.weighting != "eiv"
    false_alarm = config.health.false_alarm_probability
    return OnlineEstimator(problem, settings, rows, linear=linear, false_alarm=false_alarm)
