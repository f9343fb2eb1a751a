"""The methods under study by name: what runs on samples, on blocks, and what each can know."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from fsw.estimators.batch.solver import linear_covariance, solve
from fsw.estimators.measurement.row_functions import row_function
from fsw.estimators.methods.energy import solve_energy
from fsw.estimators.methods.fused_batch import solve_fused
from fsw.estimators.methods.momentum import solve_momentum
from fsw.estimators.methods.mrnea_batch import solve_mrnea
from fsw.estimators.methods.rda import solve_rda
from fsw.estimators.methods.result import BatchResult
from fsw.estimators.methods.system import Options, Weighting
from fsw.estimators.model.problem import Problem
from fsw.estimators.samples import SampleSet
from fsw.messages import Block
from hil.world.inertia import FloatArray

CONSISTENT = ("mrnea eiv", "rda", "fused")  # whose mean NEES must lie in its band
FUSED = "fused"
WARM = ("rda", "ce")  # begin at another method's result, as in the worker


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outcome:
    """What a method says: bodies' parameters x (10 b,), covariance, and how it ended."""

    status: str
    x: FloatArray
    covariance: FloatArray
    iterations: int
    bias_note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Method:
    """How a method is run, and the channels of its own bound (see `fisher.information`)."""

    own: str
    on_samples: Callable[[SampleSet, Problem], Outcome] | None
    rows: tuple[str, str] | None  # method and weighting of `row_function`


def _mrnea(weighting: Weighting) -> Callable[[SampleSet, Problem], Outcome]:
    def run(samples: SampleSet, problem: Problem) -> Outcome:
        options = Options(weighting=weighting, body_prior=False)
        return _outcome(solve_mrnea(samples, problem, options), problem)

    return run


def _plain(
    method: Callable[[SampleSet, Problem, Options], BatchResult],
) -> Callable[[SampleSet, Problem], Outcome]:
    def run(samples: SampleSet, problem: Problem) -> Outcome:
        bare = replace(samples, v_NB_B=None)
        return _outcome(method(bare, problem, Options(body_prior=False)), problem)

    return run


def _printed_cm(samples: SampleSet, problem: Problem) -> Outcome:
    return _outcome(solve_momentum(samples, problem, Options(body_prior=False)), problem)


METHODS: Mapping[str, Method] = {
    "mrnea ols": Method(own="mrnea", on_samples=_mrnea("ols"), rows=("mrnea", "ols")),
    "mrnea wls": Method(own="mrnea", on_samples=_mrnea("wls"), rows=("mrnea", "wls")),
    "mrnea bc": Method(own="mrnea", on_samples=_mrnea("compensated"), rows=None),
    "mrnea eiv": Method(own="mrnea", on_samples=_mrnea("eiv"), rows=("mrnea", "eiv")),
    "rda": Method(own="rda", on_samples=_plain(solve_rda), rows=("rda", "eiv")),
    "cm": Method(own="cm", on_samples=_plain(solve_momentum), rows=("cm", "eiv")),
    "cm with v_b": Method(own="cm with v_b", on_samples=_printed_cm, rows=None),
    "ce": Method(own="torque", on_samples=_plain(solve_energy), rows=("ce", "eiv")),
    FUSED: Method(own="fused", on_samples=_plain(solve_fused), rows=("fused", "eiv")),
}


def names(level: Literal["sample", "device"]) -> tuple[str, ...]:
    """Return the methods of a level, in the order of the report."""
    if level == "sample":
        return tuple(name for name, m in METHODS.items() if m.on_samples is not None)
    return tuple(name for name, m in METHODS.items() if m.rows is not None)


def on_samples(name: str, samples: SampleSet, problem: Problem) -> Outcome:
    """Run a method on samples; the prior is where it starts, not information.

    Raises
    ------
    EstimatorError when the method has no result.
    """
    run = METHODS[name].on_samples
    if run is None:
        raise ValueError(f"{name} does not run on samples")
    return run(samples, problem)


def warm_start(blocks: Sequence[Block], problem: Problem) -> FloatArray:
    """Return where the worker lets RDA and CE begin: the state MRNEA finds."""
    return solve(problem, row_function("mrnea", "eiv", problem), blocks).mean


def on_blocks(
    name: str, blocks: Sequence[Block], problem: Problem, warm: FloatArray | None = None
) -> Outcome:
    """Run a method on recorded blocks as the flight software does, the prior being information.

    `warm` is `warm_start` of the same blocks, where it is at hand. The covariances of CM and CE are
    those before the profile along their weak axes, which `fsw identify` adds.

    Raises
    ------
    EstimatorError when the method has no result.
    """
    choice = METHODS[name].rows
    if choice is None:
        raise ValueError(f"{name} does not run on blocks")
    start = None
    if choice[0] in WARM:
        start = warm_start(blocks, problem) if warm is None else warm
    solution = solve(problem, row_function(*choice, problem), blocks, None, start)
    k = problem.bodies
    covariance, note = linear_covariance(problem, *choice, solution)
    return Outcome(
        status=solution.status,
        x=solution.mean[k],
        covariance=covariance[k, k],
        iterations=solution.iterations,
        bias_note=note,
    )


def _outcome(result: BatchResult, problem: Problem) -> Outcome:
    k = problem.bodies
    return Outcome(
        status=result.status,
        x=result.mean[k],
        covariance=np.array(result.covariance[k, k]),
        iterations=result.iterations,
        bias_note=result.bias_note,
    )
