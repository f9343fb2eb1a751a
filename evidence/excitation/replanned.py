"""Compare a second motion, planned from the estimate of the first, with the first motion repeated.

Both second motions are simulated down to device bytes. The second flight's own prior is then
replaced by the first flight's estimate. The flights are independent, so only linearisation errs.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from evidence.excitation.cases import LIMITS
from fsw.config import Config
from fsw.estimators.model.inertia import report_jacobian, to_parameters
from hil.run import bench
from hil.run.progress import Quiet
from hil.world.inertia import FloatArray
from hil.world.scenario import Scenario, load
from planner import limits, spline
from planner.foreseen import foreseen_root
from planner.motion import predicted_sigma
from planner.plan import Planner
from planner.request import MotionRequest
from planner.subject import Subject, build_subject

SECOND = 1000  # seed of the second flight less the seed of the first flight
Gaussian = tuple[FloatArray, FloatArray]  # mean (p,), covariance (p, p)


@dataclass(frozen=True, slots=True, kw_only=True)
class Second:
    """The result of a second motion for one seed."""

    predicted: FloatArray  # (p,) predicted sigma of the reported quantities after both flights
    flown: FloatArray  # (p,) sigma of the reported quantities from the joined estimate
    nees: float  # of the joined estimate
    valid: bool  # whether the estimate of the second flight is valid

    @property
    def ratio(self) -> float:
        """The geometric mean of flown over predicted sigma."""
        return float(np.exp(np.mean(np.log(self.flown / self.predicted))))


def seconds(
    seed: int,
    scenario: str = "target_leo",
    request: MotionRequest | None = None,
    say: Callable[[str], None] = lambda _text: None,
) -> dict[str, Second]:
    """Return the two second motions of a seed: `nominal` (the first repeated) and `replanned`."""
    with TemporaryDirectory(prefix="hil-") as place:
        own, folder = load(scenario), Path(place)
        first, _, config = _flight(own, seed, folder / "first")
        after = build_subject(config, after=_estimate(config, first))
        found = Planner(after, limits.load(LIMITS), None, request or MotionRequest(seed=seed), say)
        path = folder / "plan.yaml"
        spline.save(found.plan().trajectory, path, {})
        again = replace(own, identification=path)
        return {
            name: _second(after, first, second, seed + SECOND, folder / name)
            for name, second in (("nominal", own), ("replanned", again))
        }


def _second(after: Subject, first: Gaussian, scenario: Scenario, seed: int, folder: Path) -> Second:
    """Simulate a second flight; return its result joined with the estimate of the first flight."""
    root = foreseen_root(after, spline.load(scenario.identification))
    (mean, covariance), valid, config = _flight(scenario, seed, folder)
    problem, p = build_subject(config).problem, len(mean)
    known = problem.prior.at(np.concatenate([mean, problem.prior_mean[p:]]))
    terms = [(first, 1.0), ((mean, covariance), 1.0)]
    terms.append(((known.mean()[:p], known.covariance()[:p, :p]), -1.0))
    information = sum(sign * np.linalg.solve(C, np.eye(p)) for (_, C), sign in terms)
    joined = np.linalg.solve(information, np.eye(p))
    x = joined @ sum(sign * np.linalg.solve(C, m) for (m, C), sign in terms)
    T, truth = np.zeros((p, p)), np.zeros(p)
    for body in after.problem.unknown:
        k, report = after.problem.body(body), scenario.truth[body]
        T[k, k] = report_jacobian(x[k])
        truth[k] = to_parameters(report[0], report[1:4], report[4:])
    return Second(
        predicted=np.array(predicted_sigma(after, root)),
        flown=np.sqrt(np.diag(T @ joined @ T.T)),
        nees=float((x - truth) @ information @ (x - truth)),
        valid=valid,
    )


def _flight(scenario: Scenario, seed: int, folder: Path) -> tuple[Gaussian, bool, Config]:
    folder.mkdir()
    setup = bench.prepare(scenario, seed, folder)
    final = bench.run_virtual(setup, Quiet(), record=False).final
    return (final.x, final.covariance), final.valid, setup.config


def _estimate(config: Config, found: Gaussian) -> dict[str, object]:
    problem = build_subject(config).problem
    return {"names": problem.names[problem.bodies], "mean": found[0], "covariance": found[1]}
