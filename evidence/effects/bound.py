"""The Cramer-Rao bound of a scenario's bodies from samples, with all other states unknown too.

The information comes from exact samples at the truth, through the rows of the flight software. The
other states (wheel inertias, forces, delays, modes, momentum, offsets, biases) are marginalised
with their priors. A window with an unreported action has no information; a new momentum follows.
"""

from collections.abc import Collection, Mapping
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.linalg import block_diag

from evidence.effects.samples import exact, rate_hz
from evidence.methods.flight_side import write_true_config
from evidence.methods.sensed import condition
from fsw.config import Config
from fsw.estimators.batch.run import run_batch
from fsw.estimators.measurement.mrnea import Rows
from fsw.estimators.measurement.row_functions import Linearisation, row_function
from fsw.estimators.model.building import build_problem
from fsw.estimators.model.problem import Problem
from fsw.estimators.model.robot import RobotModel
from fsw.messages import Block, IntArray
from hil.world.inertia import FloatArray, pi_jacobian, pi_of
from hil.world.prior import Prior
from hil.world.scenario import Scenario, load
from planner.criteria import prior_root, triangular_root

SETTLED_RISES = 8.0  # rise times after which the force of a pulse has decayed


@lru_cache(maxsize=1)
def information(name: str) -> FloatArray:
    """Return the information (p, p) of exact samples about the reports of the unknown bodies.

    A report is mass, centre of mass and inertia. The priors of the bodies are left out.
    """
    with TemporaryDirectory(prefix="effects-") as folder:
        return information_of(name, write_true_config(load(name), Path(folder)))


def information_of(name: str, config: Config) -> FloatArray:
    """Return the same information for the sensors of an error-free configuration."""
    scenario = load(name)
    blocks = condition(exact(name, config), config, rate_hz(scenario))
    model = RobotModel(config.resolve(config.robot.urdf), config.robot.tool_frame)
    problem = build_problem(config, model)
    spans = [_span(scenario, block, problem.window_s) for block in blocks]
    found: list[FloatArray] = []

    def keep(_p: Problem, mean: FloatArray, _c: FloatArray, _rows: Collection[Rows]) -> None:
        found.append(mean)

    before = [block for block, span in zip(blocks, spans, strict=True) if span == 0]
    run_batch(config, before, "fused", (), keep=keep)
    state, p = found[0].copy(), problem.bodies.stop
    state[:p] = np.concatenate([pi_of(scenario.truth[body]) for body in problem.unknown])
    count = 1 + max(span for span in spans if span is not None)
    root = _prior_root(problem, count)
    linear = Linearisation(row_function("fused", "eiv", problem), blocks)
    rows = linear(state, [span is not None for span in spans])  # no motion from one to the next
    for one, span in zip(rows, (span for span in spans if span is not None), strict=True):
        root = triangular_root(np.vstack([root, _arranged(one.A, problem, span, count)]))
    J = np.zeros((p, p))
    for body in problem.unknown:
        k = problem.body(body)
        J[k, k] = pi_jacobian(scenario.truth[body])
    last = root[-p:, -p:] @ J
    return np.asarray(last.T @ last)


def error_squared(name: str, priors: Mapping[str, Prior], error: FloatArray) -> float:
    """Return e^T F e for the error e (p,) of the reports; F is the information with the priors.

    If the estimator is efficient, the mean over the seeds is p.
    """
    sigma = np.concatenate([priors[body].sigma for body in load(name).unknown])
    return float(error @ (information(name) + np.diag(1.0 / sigma**2)) @ error)


def _span(scenario: Scenario, block: Block, window_s: float) -> int | None:
    """Return how many unreported pulses and contacts ended before a window; None during one."""
    start_s = block.index * window_s
    spans_s, system = [], scenario.thrusters
    if scenario.contact is not None:
        spans_s.append((scenario.contact.from_s, scenario.contact.to_s))
    if system is not None:
        tail_s = system.delay_s + SETTLED_RISES * system.rise_s
        spans_s += [
            (pulse.on_s, pulse.on_s + pulse.for_s + tail_s)
            for pulse in system.pulses
            if not pulse.reported
        ]
    if any(on_s < start_s + window_s and start_s < off_s for on_s, off_s in spans_s):
        return None
    return sum(off_s <= start_s for _, off_s in spans_s)


def _others(problem: Problem) -> IntArray:
    """Return the indices of all states except bodies and momentum."""
    return np.delete(np.arange(len(problem.names)), np.r_[problem.bodies, problem.at("momentum")])


def _arranged(A: FloatArray, problem: Problem, span: int, count: int) -> FloatArray:
    """Return the rows with columns: other states, a momentum for each of `count` spans, bodies."""
    momentum = A[:, problem.at("momentum")]
    held = np.zeros((len(A), count, momentum.shape[1]))
    held[:, span] = momentum
    return np.hstack([A[:, _others(problem)], held.reshape(len(A), -1), A[:, problem.bodies]])


def _prior_root(problem: Problem, count: int) -> FloatArray:
    """Return a root of the prior information in the columns of `_arranged`, without the bodies."""
    P, others, own = problem.prior_covariance, _others(problem), problem.at("momentum")
    parts = [prior_root(P[np.ix_(others, others)]), *[prior_root(P[own, own])] * count]
    root = block_diag(*(part for part in parts if part.size))
    return np.hstack([root, np.zeros((len(root), problem.bodies.stop))])
