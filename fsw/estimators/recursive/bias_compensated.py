"""The recursive estimator of MRNEA compensated for its bias (`measurement/compensated.py`)."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from fsw.config import EstimatorConfig
from fsw.errors import NUMERICAL, EstimatorError, unforeseen
from fsw.estimators.diagnosis import diagnose, plain
from fsw.estimators.measurement.compensated import (
    CompensatedSums,
    block_sums,
    compensated_solution,
    no_sums,
)
from fsw.estimators.model.problem import Problem
from fsw.estimators.plausible import plausible
from fsw.estimators.reasons import Failed
from fsw.estimators.recursive.outcome import outcome
from fsw.estimators.recursive.snapshot import Values, check_fit, kept, put
from fsw.messages import Block, Estimate, FloatArray

_STATE = (
    *("_x", "_covariance", "_bias", "_solved", "_blocks", "_gated", "_ignored"),
    *("_after", "_span_ns", "_q_rad"),
)
_SUMS = ("F", "C", "T", "expected")
FLAT_PRIOR = 1e2  # factor on the bodies' prior sigma, which makes the prior almost flat


class BiasCompensatedEstimator:
    """Recursive bias-compensated MRNEA: constant memory and work, no iteration, no change gate."""

    def __init__(self, problem: Problem, settings: EstimatorConfig) -> None:
        self._problem = problem
        self._settings = settings
        self._events: list[tuple[str, str, str]] = []
        self.reset()

    def reset(self) -> None:
        """Discard all blocks; return to the prior."""
        problem = self._problem
        p, k = len(problem.prior_mean), problem.bodies
        scale = np.ones(p)
        scale[k] = FLAT_PRIOR
        covariance = problem.prior_covariance * np.outer(scale, scale)
        inverse: FloatArray = np.asarray(np.linalg.solve(covariance, np.eye(p)), np.float64)
        self._precision = inverse
        self._flat = covariance
        self._sums = no_sums(p)
        self._x, self._covariance = problem.prior_mean.copy(), problem.prior_covariance
        self._bias = np.zeros(p)
        self._solved = False
        self._blocks = self._gated = self._ignored = 0
        self._after = -1
        self._span_ns: tuple[int, int] | None = None
        self._q_rad: FloatArray | None = None

    def adopt(self, _result: Mapping[str, Any]) -> None:
        """Raise an error: the compensated regression has no prior that could hold a batch result.

        Raises
        ------
        EstimatorError always.
        """
        raise EstimatorError("the bias-compensated regression adopts no batch result")

    @property
    def blocks(self) -> tuple[Block, ...]:
        """Return no block: only sums are kept."""
        return ()

    def snapshot(self) -> dict[str, Any]:
        """Return the whole state as plain values."""
        return kept(self, _STATE) | {
            "kind": "bias_compensated",
            "names": list(self._problem.names),
            "sums": kept(self._sums, _SUMS),
        }

    def restore(self, values: Values, _blocks: Mapping[int, Block]) -> None:
        """Continue from a snapshot. Raises EstimatorError if it is of another problem."""
        check_fit(self._problem, "bias_compensated", values)
        put(self, _STATE, values)
        self._sums = CompensatedSums(**values["sums"])

    def push(self, block: Block) -> Estimate:
        """Fold in one block and return the estimate after it."""
        if block.index <= self._after:
            self._ignored += 1
        else:
            self._after = block.index
            self._fold(block, self._usable_sums(block))
        return self.estimate(int(block.t_ns[-1]))

    def work(self) -> None:
        """Do nothing: there is no background work."""

    def finish(self) -> Estimate:
        """Return the estimate; there is nothing to settle."""
        return self.estimate(self._span_ns[1] if self._span_ns else 0)

    def events(self) -> list[tuple[str, str, str]]:
        """Return severity, code and text of what has happened since the last call."""
        events, self._events = self._events, []
        return events

    def report(self) -> dict[str, Any]:
        """Return a diagnosis of the current estimate as plain values."""
        estimate = self.finish()
        span = self._span_ns or (0, 0)
        diagnosis = diagnose(
            names=self._problem.names,
            prior_mean=self._problem.prior_mean,
            prior_covariance=self._flat,
            mean=self._x,
            covariance=estimate.covariance,
            bodies=estimate.bodies,
            duration_s=(span[1] - span[0]) * 1e-9,
            reasons=estimate.reasons,
        )
        words = {"valid": estimate.valid, "reason": estimate.reason, "blocks": self._blocks}
        words["reasons"] = list(estimate.reasons)
        return words | plain(diagnosis, self._problem.names)

    def estimate(self, t_ns: int) -> Estimate:
        """Return the published estimate; its sigma includes the bias that may remain."""
        try:
            return self._outcome(t_ns)
        except NUMERICAL as error:
            self.reset()
            why = f"the estimate was not proper ({unforeseen(error)})"
            self._events.append(("high", "ESTIMATOR_RESET", why))
        return self._outcome(t_ns)

    def _outcome(self, t_ns: int) -> Estimate:
        scale = np.sqrt(np.diag(self._covariance))
        condition = float(np.sqrt(np.linalg.cond(self._covariance / np.outer(scale, scale))))
        failed = Failed(
            few_blocks=self._blocks < self._settings.settle_blocks,
            not_excited=not self._solved or condition > self._settings.condition_limit,
        )
        removed = float(np.sqrt(np.mean((self._bias / scale) ** 2)))
        return outcome(
            self._problem,
            self._settings.method,
            self._x,
            self._covariance,
            failed=failed,
            t_ns=t_ns,
            q_rad=self._q_rad,
            blocks=self._blocks,
            gated=self._gated,
            nis=0.0,
            nis_dof=0,
            condition_number=condition,
            extra={
                "biased": 1.0,
                "bias_removed_sigma": removed,
                "ignored": float(self._ignored),
            },
        )

    def _usable_sums(self, block: Block) -> CompensatedSums | None:
        if not (block.is_complete and plausible(block)):
            return None
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            try:
                sums = block_sums(block, self._x, self._problem)
            except ValueError:  # LinAlgError, or scipy's check of its input
                return None
        finite = np.all(np.isfinite(sums.F)) and np.all(np.isfinite(sums.T))
        return sums if finite else None

    def _fold(self, block: Block, sums: CompensatedSums | None) -> None:
        if sums is None:
            self._gated += 1
            return
        self._sums = self._sums + sums
        self._blocks += 1
        self._q_rad = block.q_rad[-1]
        first = self._span_ns[0] if self._span_ns else int(block.t_ns[0])
        self._span_ns = (first, int(block.t_ns[-1]))
        try:
            self._x, self._covariance, self._bias = compensated_solution(
                self._sums, self._problem.prior_mean, self._precision
            )
            self._solved = True
        except NUMERICAL:
            self._solved = False
