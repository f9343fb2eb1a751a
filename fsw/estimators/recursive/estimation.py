"""The estimate: a prior, information, stored blocks, and passes that linearise them again.

Nothing is judged here. A solution that is not finite is a restart at the prior, which is reported.
`recursion` folds blocks in and judges them.
"""

from collections import deque
from collections.abc import Sequence

import numpy as np
from scipy.linalg import solve_triangular

from fsw.config import EstimatorConfig
from fsw.errors import EstimatorError
from fsw.estimators.measurement.impulse import Impulse
from fsw.estimators.measurement.mrnea import Rows
from fsw.estimators.measurement.row_functions import RowsFunction, usable_rows
from fsw.estimators.model.problem import Problem
from fsw.estimators.noise.sensors import SensorNoise
from fsw.estimators.recursive import pacing
from fsw.estimators.recursive.change import InnovationMonitor
from fsw.estimators.recursive.memory import Memory, data_within
from fsw.estimators.recursive.origin import Origin
from fsw.estimators.recursive.pacing import SETTLED, Pacing, distance
from fsw.messages import Block, FloatArray

EVENT_LIMIT = 64
SAMPLES = 8  # stored blocks that show whether a pass is worth its time

EventWords = tuple[str, str, str]  # severity, code, text


class Estimation:
    """State, memory and passes of one estimation.

    Attributes
    ----------
    x : (p,) state
    origin : prior of the last start
    memory : prior, data information and stored blocks
    monitor : noise level of the innovations
    pacing : when to re-linearise
    blocks, since : number of blocks folded in, and of those since the last start
    span_ns : times of the first and last node since the last start
    noise : noise of the sensors, learnt from their samples
    """

    def __init__(
        self, problem: Problem, settings: EstimatorConfig, rows: RowsFunction, *, linear: bool
    ) -> None:
        self.problem, self.linear = problem, linear
        self._settings, self._rows = settings, rows
        self._events: deque[EventWords] = deque(maxlen=EVENT_LIMIT)
        self.blocks = 0
        self.monitor = InnovationMonitor(settings.gate_probability)
        self.noise = SensorNoise(
            problem.noise_declared,
            problem.noise_samples,
            problem.window_s,
            problem.nodes,
            problem.torque_model_nm2,
        )
        self._in_doubt = len(problem.published) < len(problem.names)
        self.origin = Origin(problem, linear=linear)
        self.start(problem.prior_mean, self.origin.stated)

    def start(self, mean: FloatArray, covariance: FloatArray) -> None:
        """Begin again at a prior; keep the knowledge of the sensors."""
        self.origin.mean, self.origin.covariance = mean, covariance
        self.memory = Memory(self.origin.information(mean), self._settings.store_blocks)
        self.x = mean.copy()
        self.since = 0
        bound = pacing.SETTLED_IN_DOUBT if self._in_doubt else SETTLED
        self.pacing = Pacing(settled=self.linear, bound=bound)
        self.span_ns: tuple[int, int] | None = None

    def take_over(self, mean: FloatArray, covariance: FloatArray, blocks: int) -> None:
        """Start from a batch result over `blocks` blocks; with forgetting it fades like other data.

        Raises
        ------
        numpy.linalg.LinAlgError if the covariance is not positive definite.
        """
        if self._settings.forgetting_time_s is None:
            self.start(mean, covariance)
        else:
            prior = self.memory.prior
            self.memory.restart(prior, data_within(prior, mean, covariance))
            self.x = mean
        self.memory.at = mean
        self.blocks = self.since = blocks
        self.pacing.settled = True

    @property
    def duration_s(self) -> float:
        """Return the length of the data since the last start [s]."""
        return (self.span_ns[1] - self.span_ns[0]) * 1e-9 if self.span_ns else 0.0

    def begin_again(self, why: str) -> None:
        """Restart at the problem's prior and report why."""
        self.start(self.problem.prior_mean, self.origin.stated)
        self.monitor.restart()
        self._events.append(("high", "ESTIMATOR_RESET", why))

    def _white_covariance(self) -> FloatArray:
        """Return the covariance (p, p) if the residuals are white."""
        return self.memory.tempered(self.monitor.variance).covariance()

    def _follow_walks(self, block: Block) -> None:
        data = self.origin.follow(block, self.memory.data)
        if data is not None:
            self.memory.restart(self.origin.information(self.memory.at), data)
            if self._solve():
                self.memory.at = self._point()

    def _age(self, end_ns: int) -> None:
        time_s = self._settings.forgetting_time_s
        if time_s is not None and self.span_ns is not None:
            elapsed_s = max(0, end_ns - self.span_ns[1]) * 1e-9
            self.memory.age(float(np.exp(-0.5 * elapsed_s / time_s)))

    def _newest_rows(self, block: Block, at: FloatArray) -> Rows | None:
        """Return the rows of a block after all stored ones; None if they are not usable."""
        found = self._usable_rows((block,), at, self.memory.gained)
        return found[0] if found else None

    def _usable_rows(
        self,
        blocks: Sequence[Block],
        at: FloatArray,
        before: Impulse | None,
        fits: Sequence[bool] = (),
    ) -> list[Rows]:
        noted = [self.noise.applied(self.origin.in_epoch(block)) for block in blocks]
        return usable_rows(self._rows, noted, at, before, fits)

    def _solve(self) -> bool:
        """Solve for the state; if that is impossible, restart at the prior and return False."""
        is_few = (
            self.monitor.doubt > 1.0
        )  # then the prior outweighs the data by as much as is stated
        try:
            mean = self.memory.tempered(self.monitor.variance if is_few else 1.0).mean()
            if not np.isfinite(mean).all():
                raise EstimatorError("the estimate is not finite")
        except EstimatorError as error:
            self.begin_again(str(error))
            return False
        self.x = mean
        return True

    def _begin_pass(self) -> bool:
        """Begin a pass; return True if it has ended at once, because it is not worth its time."""
        wanted, step = self._next_point()
        memory, previous = self.memory, self.memory.at
        root = memory.information.R if self.problem.modes is not None else None
        point = self.pacing.point(wanted, previous, root)
        move = distance(memory.information.R, point - previous)
        self.pacing.begin(move, self.since, previous, memory.misfit(previous))
        if step is None:
            memory.begin(point)
        else:
            memory.at = point
            self.pacing.found_idle(step)
        return step is not None

    def _next_point(self) -> tuple[FloatArray, float | None]:
        """Return the next pass's point, and its step if the pass is not worth its time, else None.

        Where the drift alone suggests a pass, some of the blocks show the step.
        """
        drift, expected = self._drift(), True
        wanted = self._point()
        memory = self.memory
        if len(memory) > 2 * SAMPLES and drift > pacing.FAR:
            expected = self.pacing.is_expected_to_move(drift, self.since)
        if expected:
            return wanted, None
        pull = memory.pull(self._usable_rows, wanted, SAMPLES)
        if pull is None:
            return wanted, None
        for prior, sign in ((self.origin.information(wanted), 1.0), (memory.prior, -1.0)):
            pull = pull + sign * (prior.R.T @ (prior.z - prior.R @ wanted))
        step = pacing.rms(solve_triangular(memory.information.R, pull, trans=1))
        return wanted, step if step < pacing.WORTH else None

    def _advance_pass(self, most: int) -> bool:
        """Re-linearise the next blocks of a pass; return whether the pass has ended with them."""
        memory = self.memory
        x, R = self.x, memory.information.R
        if not memory.advance(self._usable_rows, most):
            return False
        memory.replace_prior(self.origin.information(memory.at))
        if not self._solve():
            return False
        k = self.problem.bodies if self._in_doubt else None
        step = max(distance(root, self.x - x, k) for root in (R, memory.information.R))
        self.pacing.end(step, memory.failed, memory.misfit(memory.at))
        return True

    def _drift(self) -> float:
        """Return the whitened rms distance of the estimate from the point of the last pass."""
        return distance(self.memory.information.R, self.x - self.memory.at)

    def _point(self) -> FloatArray:
        """Return the estimate with consistent bodies; for linear weightings the prior's mean."""
        if self.linear:
            return self.problem.prior_mean
        return self.problem.consistent(self.x, self.memory.information.covariance)
