"""From a request to a checked trajectory: starts, optimisation, dense check, tightening, verdict.

A trajectory passes only if every limit holds on a grid ten times denser than the optimiser's, for
every member of the prior set, and if it reduces the sigmas. Members that break a limit join the
optimiser's set; a limit that is exceeded between samples is tightened by the excess.
"""

import multiprocessing
import os
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fsw.errors import ConfigError
from fsw.exchange.tied import end_with
from fsw.messages import FloatArray
from planner import criteria
from planner.assess import information_root
from planner.collision import Collisions
from planner.design import Criterion, Grid, LimitRows
from planner.foreseen import foreseen_root
from planner.guesses import FIRST_MARGIN, Guesses
from planner.limits import MotionLimits
from planner.request import (
    ROUNDS,
    MotionPlan,
    MotionRequest,
    infeasible,
    later,
    shown,
)
from planner.solver import Effort, optimise
from planner.spline import SplineLayout, Trajectory
from planner.subject import Subject
from planner.verify import SHARE_MARGIN, Use, every_limit

DENSER = 10
TORQUE_MARGIN = 0.02  # first margin, share of the bound: torque varies fastest between samples
SMALL_SHRINKS = (0.999, 0.997, 0.994, 0.99, 0.985)  # factors that hardly change the criterion
LARGE_SHRINKS = (0.98, 0.97, 0.96, 0.94, 0.92, 0.9, 0.87, 0.84, 0.8)
REPAIRABLE = 0.05  # excess up to which another round may help
PROBE_RAD = 0.1  # size of the motion that shows which limits prevent learning
NOTHING_LEARNT = 0.9  # largest geometric mean of sigma over prior sigma of a passing motion

Report = Callable[[str], None]


class Planner:
    """Plans the motion of one request, with all values that are computed once per request."""

    def __init__(
        self,
        subject: Subject,
        limits: MotionLimits,
        collisions: Collisions | None,
        request: MotionRequest,
        report: Report = lambda _text: None,
    ) -> None:
        intervals = max(round(request.duration_s / request.knot_s), 4)
        self.layout = SplineLayout(
            duration_s=request.duration_s,
            intervals=intervals,
            n=subject.model.n,
            closed=request.closed,
        )
        self.subject, self.limits, self.request, self.report = subject, limits, request, report
        self.collisions = collisions
        self.grid = Grid(self.layout, request.rate_hz)
        self.rows = LimitRows(subject, self.grid, limits, collisions)
        self.criterion = Criterion(
            subject, self.grid, request.criterion, request.gamma, tuple(subject.draws[:2])
        )
        self.members = [subject.x, *subject.draws]
        self.fixed = self._fixed()
        self.guesses = Guesses(limits, self.layout, self.rows, self.members, self.fixed)

    def plan(self, guess: Trajectory | None = None) -> MotionPlan:
        """Optimise from several starts; return the best trajectory that keeps every limit.

        Parameters
        ----------
        guess : motion at which the first start begins; None: every start is random

        Raises
        ------
        InfeasibleError with limit, amount and time if no motion passes; ConfigError: wrong guess.
        """
        self._check_start_pose()
        best: MotionPlan | None = None
        nearest: list[Use] = []
        ends = self._all(None if guess is None else self._from(guess))
        for found in ends:
            if isinstance(found, MotionPlan):
                if best is None or found.value < best.value:
                    best = found
            elif not nearest or found[0].excess < nearest[0].excess:
                nearest = found
        if best is None:
            raise infeasible("no trajectory found keeps every limit; the nearest one has", nearest)
        self._require_learning(best)
        words = (self._words(found, best) for found in ends)
        return replace(best, starts=tuple(f"start {k}: {text}" for k, text in enumerate(words, 1)))

    def _words(self, found: MotionPlan | list[Use], best: MotionPlan) -> str:
        """Return the result of one start in words."""
        if isinstance(found, list):
            return f"no motion that keeps every limit; {found[0].text()}"
        name = self.request.criterion
        chosen = ", taken" if found is best and self.request.starts > 1 else ""
        return f"{name} {shown(name, found.value):.6g}{chosen}"

    def _all(self, guess: FloatArray | None) -> list[MotionPlan | list[Use]]:
        """Return the results of all starts, computed in parallel by `jobs` processes."""
        starts, jobs = range(self.request.starts), min(self.request.jobs, self.request.starts)
        if jobs == 1:
            return [self.one_start(start, guess) for start in starts]
        fork = multiprocessing.get_context("fork")  # the model's functions are inherited
        with fork.Pool(jobs, initializer=_inherit, initargs=(os.getpid(), self, guess)) as pool:
            return pool.map(_inherited, starts, chunksize=1)

    def one_start(self, start: int, guess: FloatArray | None) -> MotionPlan | list[Use]:
        """Return the plan of one start; if no motion passes, the limits of the nearest one."""
        seed, count = self.request.seed, self.request.starts
        self.report(f"start {start + 1} of {count}")
        rng = np.random.default_rng([seed, start] if start else seed)
        found = self._one(self._far(rng) if guess is None or start else guess)
        name = self.request.criterion
        if count == 1 or isinstance(found, list) or name in criteria.REGRESSOR_CRITERIA:
            return found
        whole = replace(found.trajectory, firings=self.limits.firings)  # judged by all states
        root = foreseen_root(self.subject, whole)
        return replace(found, value=criteria.fused(name, root, self.subject.scale).value)

    def _far(self, rng: np.random.Generator) -> FloatArray:
        """Return the variables at which a start without a guess begins.

        After an earlier result, a random motion adds so little that the criterion is almost flat.
        The search then begins at the motion that is planned for the wide prior.
        """
        own = self.subject
        if np.array_equal(own.prior_root, own.wide_root):
            return self.first_guess(rng)
        wide = Planner(
            replace(own, prior_root=own.wide_root),
            self.limits,
            self.collisions,
            self.request,
            self.report,
        )
        z = wide.first_guess(rng)
        found = wide._one(z)
        return self._from(found.trajectory) if isinstance(found, MotionPlan) else z

    def _from(self, guess: Trajectory) -> FloatArray:
        """Return the variables nearest to a trajectory that is stretched to the duration."""
        if guess.n != self.layout.n:
            raise ConfigError(f"the start trajectory must have {self.layout.n} joints")
        t_s = np.linspace(0.0, self.layout.duration_s, 10 * self.layout.points)
        q = guess.evaluate(t_s * guess.duration_s / self.layout.duration_s)[0]
        z = np.linalg.lstsq(self.layout.weights(t_s)[0], q, rcond=None)[0].ravel()
        z[list(self.fixed)] = list(self.fixed.values())
        return np.asarray(z)

    def first_guess(self, rng: np.random.Generator) -> FloatArray:
        """Return the best of some random feasible motions, or else a nearly feasible one."""
        found: list[FloatArray] = []
        for _ in range(self.request.candidates):
            z = self.guesses.random_feasible(rng)
            if z is not None:
                found.append(z)
        if found:
            return self._shrunk(min(found, key=self.criterion.value), SMALL_SHRINKS)
        return self.guesses.nearest_feasible(self.guesses.random_motion(rng))

    def check(self, z: FloatArray) -> list[Use]:
        """Return the worst use of every limit on the dense grid, the largest excess first."""
        return every_limit(
            self.subject,
            self.limits,
            self.collisions,
            self.layout.trajectory(z),
            DENSER * self.request.rate_hz,
            self.members,
        )

    def _one(self, z: FloatArray) -> MotionPlan | list[Use]:
        """Optimise from one start; return the plan, or the limits of the nearest motion found."""
        in_set: list[int] = [0]
        uses = self.check(z)
        best = self._passed(z, uses, 0, 0) if uses[0].excess <= -SHARE_MARGIN else None
        margins = {use.kind: _first_margin(use.kind) for use in uses}
        iterations, gradients = self.request.iterations, 0
        for turn in range(1, ROUNDS + 1):
            solution = optimise(
                self.criterion,
                self.rows,
                [self.members[k] for k in in_set],
                z,
                self.fixed,
                margins,
                Effort(iterations=iterations),
                self._progress(turn),
            )
            gradients += solution.gradients
            z = self._shrunk(solution.z, SMALL_SHRINKS)
            uses = self.check(z)
            if uses[0].excess <= -SHARE_MARGIN:
                return _better(best, self._passed(z, uses, turn, gradients))
            best = self._repaired(best, z, turn, gradients)
            broken = [use for use in uses if use.excess > -SHARE_MARGIN]
            new = sorted({use.member for use in broken} - set(in_set))
            in_set += new
            if not new and uses[0].excess > REPAIRABLE:
                z = self.guesses.nearest_feasible(z, in_set)
                broken = self.check(z)
                if broken[0].excess > REPAIRABLE:
                    return best or broken
            self.report(f"round {turn}: {broken[0].text()}; tightened")
            for use in broken:
                if -SHARE_MARGIN < use.excess <= REPAIRABLE:
                    margins[use.kind] += max(use.excess, 0.0) + 2 * SHARE_MARGIN
            iterations = later(self.request.iterations)
        return best or self.check(self.guesses.nearest_feasible(z, in_set))

    def _repaired(
        self, best: MotionPlan | None, z: FloatArray, turn: int, gradients: int
    ) -> MotionPlan | None:
        """Return the better of `best` and z shrunk until it passes; `best` if z never passes."""
        smaller = self._shrunk(z, LARGE_SHRINKS)
        uses = self.check(smaller)
        if uses[0].excess > -SHARE_MARGIN:
            return best
        return _better(best, self._passed(smaller, uses, turn, gradients))

    def _passed(self, z: FloatArray, uses: list[Use], turn: int, gradients: int) -> MotionPlan:
        return MotionPlan(
            trajectory=self.layout.trajectory(z),
            value=self.criterion.value(z),
            uses=uses,
            rounds=turn,
            gradients=gradients,
        )

    def _shrunk(self, z: FloatArray, factors: tuple[float, ...]) -> FloatArray:
        """Return the motion with the first of the `factors` that makes it pass; else unchanged."""
        excess = self.check(z)[0].excess
        if self.limits.end_rad is not None or not -SHARE_MARGIN < excess < REPAIRABLE:
            return z
        points = z.reshape(self.layout.rows, self.layout.n)
        for factor in factors:
            smaller = (points[0] + factor * (points - points[0])).ravel()
            if self.check(smaller)[0].excess <= -SHARE_MARGIN:
                return np.asarray(smaller)
        return z

    def _progress(self, turn: int) -> Callable[[int, float, str, float], None]:
        def show(iteration: int, value: float, kind: str, excess: float) -> None:
            side = "beyond" if excess > 0 else "inside"
            worst = f", worst {kind} {100 * abs(excess):.2g} % {side} its bound" if kind else ""
            self.report(
                f"round {turn}, evaluation {iteration}: {self.request.criterion} "
                f"{shown(self.request.criterion, value):.6g}{worst}"
            )

        return show

    def _fixed(self) -> dict[int, float]:
        n = self.layout.n
        fixed: dict[int, float] = {}
        if self.limits.start_rad is not None:
            fixed |= dict(enumerate(self.limits.start_rad))
        if self.limits.end_rad is not None and not self.layout.closed:
            last = (self.layout.rows - 1) * n
            fixed |= {last + k: value for k, value in enumerate(self.limits.end_rad)}
        return fixed

    def _check_start_pose(self) -> None:
        for key in ("start_rad", "end_rad"):
            pose = getattr(self.limits, key)
            if pose is None:
                continue
            uses = self.check(np.tile(np.array(pose), (self.layout.rows, 1)).ravel())
            if uses[0].excess > 0:
                at_s = 0.0 if key == "start_rad" else self.layout.duration_s
                uses = [replace(use, time_s=at_s) for use in uses]
                raise infeasible(f"{key} breaks", uses)

    def _require_learning(self, plan: MotionPlan) -> None:
        """Raise InfeasibleError if a motion hardly reduces the sigmas of the unknowns."""
        ratio = sigma_ratio(self.subject, plan.trajectory, self.request.rate_hz)
        if ratio <= NOTHING_LEARNT:
            return
        shape = (self.layout.rows, self.layout.n)
        probe = np.random.default_rng(self.request.seed).uniform(-1.0, 1.0, shape)
        probe = plan.trajectory.points_rad[0] + PROBE_RAD * (probe - probe[0])
        raise infeasible(
            f"within the limits nothing is learnt: the sigmas stay at {ratio:.3f} of the prior's "
            f"(at most {NOTHING_LEARNT} is asked); a motion of {PROBE_RAD} rad about the same pose "
            "has",
            self.check(probe.ravel()),
        )


_planner: list[tuple[Planner, FloatArray | None]] = []  # set in each process of the pool


def _inherit(parent: int, planner: Planner, guess: FloatArray | None) -> None:
    end_with(parent)
    _planner[:] = [(planner, guess)]


def _inherited(start: int) -> MotionPlan | list[Use]:
    planner, guess = _planner[0]
    return planner.one_start(start, guess)


def sigma_ratio(subject: Subject, trajectory: Trajectory, rate_hz: float) -> float:
    """Return the geometric mean of the unknowns' sigma over their prior sigma after a motion."""
    R = information_root(subject, trajectory, rate_hz)
    sigma = np.sqrt(np.diag(criteria.report_covariance(R, subject.scale)))
    keep = subject.scale.weights > 0
    return float(np.exp(np.mean(np.log(sigma[keep] / subject.scale.prior_sigma[keep]))))


def _first_margin(kind: str) -> float:
    return TORQUE_MARGIN if kind.startswith(("torque", "force")) else FIRST_MARGIN


def _better(one: MotionPlan | None, other: MotionPlan) -> MotionPlan:
    return other if one is None or other.value <= one.value else one
