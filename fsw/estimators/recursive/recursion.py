"""The recursion: blocks are folded into an estimate and judged, in bounded units of work.

A block is folded into the square-root information at once; passes over the stored blocks then
re-linearise them at the current estimate, a block per unit of work. A run of blocks that noise
does not explain re-opens the estimate to the prior's spread; a prior that the data contradict is
widened. Both are reported as events. `online` decides when units of work are done.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from copy import copy, deepcopy
from dataclasses import replace
from typing import Any

import numpy as np

from fsw.config import EstimatorConfig
from fsw.estimators.conditioning.plausible import plausible
from fsw.estimators.measurement.first_rate import at_first_rate
from fsw.estimators.measurement.mrnea import Rows
from fsw.estimators.measurement.row_functions import RowsFunction
from fsw.estimators.model.problem import Problem
from fsw.estimators.noise.creep import changes, worst_change
from fsw.estimators.noise.likeness import in_words as in_words_of_likeness
from fsw.estimators.recursive.estimation import EVENT_LIMIT, Estimation, EventWords
from fsw.estimators.recursive.isolation import ChannelScreen
from fsw.estimators.recursive.memory import Memory
from fsw.estimators.recursive.outside import OutsideWatch, Verdict
from fsw.estimators.recursive.pacing import SETTLED
from fsw.estimators.recursive.prior_groups import in_words, widen
from fsw.estimators.recursive.snapshot import Values, kept, put, to_information
from fsw.estimators.recursive.trust import Trust
from fsw.messages import Block, FloatArray

NOISE_BLOCKS = 4  # between two judgements of the sensors' noise
WATCH_BLOCKS = 2  # between two looks for what creeps
NEAR = 1.0  # whitened rms distance from the linearisation up to which rows show what creeps
LEVEL_BLOCKS = 64  # newest blocks that determine the noise level
ABSURD = 1e12  # normalised innovation squared per degree of freedom at which any block is rejected
AT_ONCE = 16  # most blocks that are re-linearised at once where nothing waits for it

_STATE = (
    *("x", "blocks", "since", "gated", "changes", "span_ns", "q_rad", "armed", "conflict"),
    *("_check_due", "_level_due", "_watch_due", "_rss", "_coloured", "_alike", "spared"),
)


class Recursion(Estimation):
    """One estimation and the judgement of it; results depend on the blocks alone.

    Attributes
    ----------
    gated, changes : number of rejected blocks, and of re-openings
    q_rad : (n,) newest joint positions
    armed : whether blocks are gated: from the first valid estimate on
    conflict : whether the data contradicted the prior at the last check
    spared : whether an alarm against this estimate has been refuted; a second one is believed
    screen, trust : judge of single channels; judge of the residuals at the last check
    used : the newest block, without the channels that were left out
    """

    def __init__(
        self,
        problem: Problem,
        settings: EstimatorConfig,
        rows: RowsFunction,
        screen: ChannelScreen,
        *,
        linear: bool,
    ) -> None:
        self.screen = screen
        self.gated = self.changes = 0
        self.q_rad: FloatArray | None = None
        self.used: Block | None = None
        self._coloured = self._alike = False  # NOISE_CORRELATED reported: of samples, of residuals
        watches = problem.watches_outside
        self.outside = OutsideWatch(problem, settings.gate_probability) if watches else None
        super().__init__(problem, settings, rows, linear=linear)

    def start(self, mean: FloatArray, covariance: FloatArray) -> None:
        """Begin again at a prior; keep the counters and the knowledge of the sensors."""
        super().start(mean, covariance)
        self.armed = self.conflict = self.spared = False
        self.trust = Trust()
        self._check_due = self._level_due = self._watch_due = False
        self._rss = 0.0
        if self.outside is not None:
            self.outside.forget()

    def snapshot(self) -> dict[str, Any]:
        """Return the whole state as plain values; stored blocks are referred to by their index."""
        return (
            kept(self, _STATE)
            | self.origin.snapshot()
            | {
                "monitor": self.monitor.snapshot(),
                "pacing": self.pacing.snapshot(),
                "trust": self.trust.snapshot(),
                "noise": self.noise.snapshot(),
                "memory": self.memory.snapshot(),
                **({} if self.outside is None else {"outside": self.outside.snapshot()}),
            }
        )

    def restore(self, values: Values, blocks: Mapping[int, Block]) -> None:
        """Continue from a snapshot; raise EstimatorError, unchanged, if a block is missing."""
        prior = to_information(values["memory"]["prior"])
        memory = Memory(prior, self._settings.store_blocks)
        memory.restore(values["memory"], blocks, self._usable_rows)
        self.origin.restore(values)
        self.noise.restore(values["noise"])
        self.memory = memory
        put(self, _STATE, values)
        self.monitor.restore(values["monitor"])
        self.pacing.restore(values["pacing"])
        self.trust.restore(values["trust"])
        if self.outside is not None and "outside" in values:
            self.outside.restore(values["outside"])

    def take_events(self) -> list[EventWords]:
        """Return severity, code and text of what has happened since the last call."""
        drained = list(self._events) + ([] if self.outside is None else self.outside.take_events())
        self._events.clear()
        return drained

    def covariance(self) -> FloatArray:
        """Return the covariance (p, p), which grows with noise level and likeness of residuals."""
        covariance = self._white_covariance()
        return self.trust.widened(covariance, self.since)

    @property
    def has_work(self) -> bool:
        """Return whether a unit of work is expected to change anything."""
        if not len(self.memory):
            return False
        busy = self._after_pass or self.memory.in_pass
        return busy or self.pacing.is_worth_a_pass(self._drift(), self.since)

    @property
    def _after_pass(self) -> bool:
        return self._level_due or self._check_due or self._watch_due

    def work(self, most: int = 1) -> int:
        """Do units of work, `most` at most; return how many.

        One unit: learn the noise level, check the prior, look for what creeps, begin a pass, or
        re-linearise a block in a pass. Only the blocks of a pass are more than one unit.
        """
        units = 1
        if self._level_due:
            self._learn_level()
        elif self._check_due:
            self._check_prior()
        elif self._watch_due:
            self._watch()
        elif self.memory.in_pass:
            units = max(1, min(most, self.memory.left))
            self._level_due = self._advance_pass(units)
            self._check_due = self._level_due and self.pacing.settled
        else:
            self._level_due = self._check_due = self._begin_pass()
        return units

    def settle(self, max_passes: int) -> None:
        """Re-linearise all stored blocks until the estimate stays, or `max_passes` times."""
        if self.linear or not len(self.memory):
            return
        limit = self.memory.passes + max_passes
        while self.memory.passes < limit or self._after_pass:
            rests = self.pacing.settled and not self.memory.in_pass and not self._after_pass
            if rests and self._drift() < SETTLED / 10:
                break
            self.work(AT_ONCE)

    def fold(self, block: Block) -> bool:
        """Linearise a new block, judge it, and fold it in if it fits.

        Returns
        -------
        whether the blocks no longer fit the estimate, which must be re-opened (`reopened`)
        """
        self.monitor.step = 0.0
        if self.outside is not None:
            if self.armed:
                verdict = self._outside_verdict(block, self.outside)
                if verdict is not Verdict.FITS:
                    return verdict is Verdict.CHANGE
            block = self._at_momentum(block, self.outside)
        self._follow_walks(block)
        at = self.memory.at if self._in_doubt else self._point()
        if not self.linear and not len(self.memory) and not self.since:
            self.memory.at = at = at_first_rate(block, at, self.problem)
        rows = self._newest_rows(block, at) if plausible(block) else None
        if rows is not None and self.armed:
            block, rows = self._screened(block, rows, at)
        self.used = block
        if self.outside is not None and self.outside.has_acted:  # a batch knows one momentum only
            self.used = replace(block, has_attitude=False)
        if rows is None:
            self._leave_out(block)
            return False
        end_ns = int(block.t_ns[-1])
        self._age(end_ns)
        innovation = rows.b - rows.A @ (self.x - at)
        white = self.memory.information.whitened(rows.A, innovation)
        judgement = self.monitor.judge(white, armed=self.armed)
        if self.monitor.nis > ABSURD * len(white):
            self._leave_out(block)
            return False
        self.q_rad = block.q_rad[-1]
        self.trust.note(self.monitor.level)
        if not judgement.accepted:
            self._leave_out(block)
            if self.problem.modes is not None:  # the arm moved, and its modes with it
                self.memory.add(block, rows, at, keep=not self.linear, weight=0.0)
        elif not self._absorb(block, rows, at, end_ns):
            return False
        elif self.blocks % NOISE_BLOCKS == 0:
            self._learn_noise()
        return judgement.changed

    def _leave_out(self, block: Block) -> None:
        """Count a block that is left out; an implausible one does not speak against the model."""
        self.gated += 1
        if plausible(block):
            self.trust.leave_out()

    def _outside_verdict(self, block: Block, watch: OutsideWatch) -> Verdict:
        """Return whether a block fits; else leave it out."""
        if not plausible(block):
            return Verdict.FITS
        root = self.memory.information.covariance_root()
        verdict = watch.judge(self.noise.applied(block), self.x, root, self.monitor.level)
        if verdict is Verdict.FITS:
            return verdict
        nothing = np.zeros_like(block.has_joint)
        self.used = replace(block, has_joint=nothing, has_gyro=False, has_accelerometer=False)
        self.gated += 1
        return verdict

    def _at_momentum(self, block: Block, watch: OutsideWatch) -> Block:
        """Begin with a new momentum after a wrench, if it is found; return the block to be used.

        Until the momentum is found, the block has no attitude, so that rates are used as measured.
        With modes no momentum is sought, because the wrench has moved the modes unseen.
        """
        if not watch.momentum_lost:
            return block
        problem, memory, at = self.problem, self.memory, self._point()
        found = at_first_rate(block, at, problem) if plausible(block) else at
        if self.linear or problem.modes is not None or found is at or not watch.has_released:
            return replace(block, has_attitude=False)
        data = self.origin.with_momentum(found[problem.at("momentum")], memory.data)
        memory.restart(self.origin.information(at), data)
        if not self._solve():
            return replace(block, has_attitude=False)
        memory.at = found
        watch.found_momentum()
        return block

    def _screened(self, block: Block, rows: Rows, at: FloatArray) -> tuple[Block, Rows | None]:
        """Return the block without the channels that do not fit the model, and its rows."""
        root, level = self.memory.information.covariance_root(), self.monitor.level
        used = self.screen.judge(block, rows, self.x - at, root, level)
        if used is block:
            return block, rows
        return used, self._newest_rows(used, at)

    def residual_variance(self) -> float:
        """Return the ratio of the residuals' variance to the declared one, for the regression.

        It is their sum of squares over (rows - states); 1 while there are no more rows than states.
        """
        spare = self.memory.rows - len(self.x)
        return self._rss / spare if spare > 0 else 1.0

    def _absorb(self, block: Block, rows: Rows, at: FloatArray, end_ns: int) -> bool:
        """Fold in the rows of a block; return False if the recursion has restarted instead."""
        c = rows.b + rows.A @ at
        before, R = self.x, self.memory.information.R
        self.memory.add(block, rows, at, keep=not self.linear)
        self.blocks += 1
        self.since += 1
        self.noise.note(block)
        self.span_ns = (self.span_ns[0] if self.span_ns else int(block.t_ns[0]), end_ns)
        self._watch_due = self.problem.watched is not None and self.blocks % WATCH_BLOCKS == 0
        if not self._solve():
            return False
        residual, step = c - rows.A @ self.x, R @ (self.x - before)
        self._rss += float(residual @ residual + step @ step)
        return True

    def reopened(self) -> Recursion:
        """Return a recursion that begins at this estimate with the prior's spread.

        It has the counters, the events and the knowledge of the sensors. This one stays as it is,
        without its events, with Page's sum at zero and no block in question.
        """
        mean = self._point()
        self._watch()
        self.monitor.restart()
        opened = copy(self)
        opened.origin = copy(self.origin)
        opened.monitor, opened.noise = deepcopy(self.monitor), deepcopy(self.noise)
        self._events = deque(maxlen=EVENT_LIMIT)
        if self.outside is not None:
            opened.outside = self.outside.copied()
            self.outside.forget()
        opened.changes += 1
        opened.start(mean, self.origin.stated)
        opened.trust = self.trust.successor(self.since, opened.changes)
        opened.report_opening(self.since)
        return opened

    def resume(self, opened: Recursion, blocks: int) -> None:
        """Continue in place of a re-opened recursion whose alarm `blocks` blocks have refuted."""
        text = f"the {blocks} blocks since fit the estimate before the change; it continues"
        every = (*opened._events, *self._events, ("info", "CHANGE_REFUTED", text))
        self._events = deque(every, maxlen=EVENT_LIMIT)
        self.spared = True

    def report_opening(self, blocks: int) -> None:
        """Report a change that was found after a number of blocks."""
        text = f"the innovations no longer fit the {blocks} blocks before; estimate re-opened"
        unknown = self.problem.unknown
        if len(unknown) > 1:
            text += f"; they do not tell which of {' and '.join(unknown)} has changed"
        text += "; it did not fit before either and must fit for longer now" * self.trust.suspect
        self._events.append(("medium", "CHANGE_DETECTED", text))

    def _learn_level(self) -> None:
        self._level_due = False
        monitor, known = self.monitor, self.monitor.level
        # few windows move the state towards the prior, whose residuals are not noise
        at = self.x if monitor.doubt == 1.0 else self.memory.information.mean()
        levels, dof = self.memory.residual_levels(at, LEVEL_BLOCKS)
        fitted = self.memory.fitted() * (self.since <= LEVEL_BLOCKS)
        monitor.learn_level(levels, dof, fitted, is_held=not self.problem.is_free)
        if monitor.doubt > 1.0 and not self._solve():
            return
        rows, white = self.memory.rows_at(self.x), self._white_covariance()
        self.trust.judge(self.problem, *rows, monitor.level, white, monitor.doubt)
        bodies = self.problem.names[: self.problem.bodies.stop]
        likely = self.trust.likely(white, self.since)
        words = in_words_of_likeness(white, likely, bodies) * self.trust.alike
        if words and not self._alike:
            self._events.append(("medium", "NOISE_CORRELATED", words))
        self._alike = bool(words)
        is_loud = monitor.level > 1.0 == monitor.doubt  # few windows show a level by chance
        if self.pacing.settled and is_loud and known == 1.0:
            ratio = np.sqrt(monitor.level)
            text = (
                f"residuals are {ratio:.2f} times the declared noise; sigmas follow the residuals"
            )
            self._events.append(("medium", "NOISE_ABOVE_DECLARED", text))

    def _watch(self) -> None:
        """Look for what creeps; before the estimate has settled, the score shows the start."""
        self._watch_due = False
        if self.linear or not self.pacing.settled or self._drift() > NEAR:
            return
        memory, level = self.memory, self.monitor.level
        white = memory.tempered(level).covariance()
        scores = memory.scores()
        found = changes(self.problem, scores, len(scores), self.x, white, level)
        known = self.trust.creeping
        self.trust.watch(worst_change(found))
        if self.trust.creeping and not known:
            self._events.append(("medium", "SENSOR_CREEPS", self.trust.creeping))

    def _learn_noise(self) -> None:
        """Add the noise that is found to covariances; all stored blocks are then re-linearised."""
        if self.linear or not self.noise.learn():
            return
        self.pacing.settled = False
        words = self.noise.words(self.problem.model.torque_units)
        if words and not self._coloured:
            text = f"noise is correlated in time, sigmas follow it: {words}"
            self._events.append(("medium", "NOISE_CORRELATED", text))
        self._coloured = bool(words)

    def _check_prior(self) -> None:
        """Widen the groups of the prior that the data contradict; let the estimate settle again."""
        self._check_due = False
        covariance = self._white_covariance()  # the estimate's own; a wider one has another mean
        prior = self.origin.mean, self.origin.covariance
        widened, found = widen(self.problem, prior, (self.x, covariance))
        self.conflict = bool(found)
        self.trust.suspect |= any(group.of_model for group in found)
        if all(group.factor == 1.0 for group in found):
            return
        self.origin.covariance = widened
        self.memory.replace_prior(self.origin.information(self.memory.at))
        if not self._solve():
            return
        self.pacing.settled = False
        text = in_words(found) + self.problem.suspicion(self.x)
        self._events.append(("medium", "PRIOR_CONFLICT", text))
