"""Compare each criterion's optimised motion with random ones; check its limits in the truth."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from evidence.excitation.cases import DEFAULT, joint_spline, planner, subject, truth
from hil.world.limits import LimitCheck, check, worst
from hil.world.truth import simulate
from planner import criteria
from planner.design import Criterion
from planner.request import MotionPlan, MotionRequest, shown

TIME_RATIO = 10.0  # random search gets this many times the optimiser's processor time
LEAST_RANDOM = 300  # least number of random motions
FEW = 20  # iterations of a criterion whose evaluation is cheap compared with the limits
RANDOM_SEED = 1000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contest:
    """The result of one criterion on one system: an optimised and many random motions."""

    system: str
    criterion: criteria.Name
    plan: MotionPlan
    optimised: float
    best_random: float
    median_random: float
    randoms: int
    optimiser_s: float  # processor time, as all times here
    evaluation_s: float  # one evaluation of the criterion alone
    random_s: float
    dense_excess: float  # largest excess over a limit, as a share of it; negative inside
    truth_limit: str  # name of the most used limit in the simulated truth
    truth: LimitCheck

    @property
    def evaluations(self) -> float:
        """The optimiser's cost, as a number of evaluations of the criterion alone."""
        return self.optimiser_s / self.evaluation_s


def contests(
    system: str,
    names: tuple[criteria.Name, ...],
    say: Callable[[str], None],
    *,
    time_ratio: float = TIME_RATIO,
    least_random: int = LEAST_RANDOM,
    iterations: int | None = None,
) -> list[Contest]:
    """Optimise each criterion, then draw random motions for `time_ratio` times that long."""
    own = subject(system)
    plans: dict[criteria.Name, tuple[MotionPlan, float]] = {}
    for name in names:
        turns = iterations or (FEW if name in criteria.REGRESSOR_CRITERIA else DEFAULT.iterations)
        one = planner(own, MotionRequest(criterion=name, iterations=turns))
        began = time.process_time()
        plan = one.plan()
        plans[name] = (plan, time.process_time() - began)
        say(f"{system} {name}: {shown(name, plan.value):.6g} in {plans[name][1]:.1f} s")
    values = {name: [] for name in names}  # type: dict[criteria.Name, list[float]]
    spent = dict.fromkeys(names, 0.0)
    chance = planner(own)
    judges = {name: Criterion(own, chance.grid, name, chance.request.gamma) for name in names}
    rng = np.random.default_rng(RANDOM_SEED)
    while any(
        spent[name] < time_ratio * plans[name][1] or len(values[name]) < least_random
        for name in names
    ):
        began = time.process_time()
        z = chance.guesses.random_feasible(rng)
        drawn_s = time.process_time() - began
        if z is None:
            continue
        for name in names:
            began = time.process_time()
            values[name].append(judges[name].value(z))
            spent[name] += drawn_s + time.process_time() - began
    result = []
    for name in names:
        plan, seconds = plans[name]
        limit, use = _in_truth(system, plan)
        found = values[name]
        result.append(
            Contest(
                system=system,
                criterion=name,
                plan=plan,
                optimised=shown(name, plan.value),
                best_random=shown(name, min(found)),
                median_random=shown(name, float(np.median(found))),
                randoms=len(found),
                optimiser_s=seconds,
                evaluation_s=_evaluation_s(judges[name], chance.layout.rows * own.model.n),
                random_s=spent[name],
                dense_excess=plan.uses[0].excess,
                truth_limit=limit,
                truth=use,
            )
        )
    return result


def _in_truth(system: str, plan: MotionPlan) -> tuple[str, LimitCheck]:
    """Return the name and the use of the most used limit in a MuJoCo simulation of the motion."""
    robot, spline = truth(system), joint_spline(plan.trajectory)
    checks = check(robot, simulate(robot, spline, 0.0, spline.duration_s, 0.01))
    return worst(checks)


def _evaluation_s(criterion: Criterion, size: int) -> float:
    """Return the shortest processor time of ten evaluations [s]."""
    times = []
    rng = np.random.default_rng(0)
    for _ in range(10):
        z = 0.3 * rng.standard_normal(size)
        began = time.process_time()
        criterion.value(z)
        times.append(time.process_time() - began)
    return min(times)
