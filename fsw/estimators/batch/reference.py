"""Arm and calibration from a reference: a recording of the same robot without the unknown body.

It is common practice to record a motion empty and loaded and to identify the difference, so that
errors of the links, friction, scales and zeros cancel. Here that is exact: these errors are states,
and their estimate from the reference, with all of its covariance, is the prior of the loaded run.
The two motions need not be alike. Errors that the reference does not show keep their prior. Biases,
momentum and wrenches differ from run to run, so the reference gives no prior of these. Friction
depends on the gears' temperature: what the reference shows of it is uncertain by its drift.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from fsw.errors import NUMERICAL, EstimatorError, unforeseen
from fsw.estimators.batch.settle import settle
from fsw.estimators.measurement.mrnea import Rows
from fsw.estimators.measurement.row_functions import Linearisation, row_function
from fsw.estimators.model.problem import IMPLAUSIBLE, IndexArray, Problem
from fsw.estimators.model.state_groups import GROUPS, group_of
from fsw.messages import Block, FloatArray

TORQUE_MODEL = "torque_model_sigma_nm"


def without_bodies(problem: Problem) -> Problem:
    """Return the problem of the robot without its unknown bodies, except the base."""
    U = problem.U.copy()
    for name in problem.unknown:
        if name != "base":
            U[:, problem.body(name)] = 0.0
    return replace(problem, U=U)


def repeated(problem: Problem) -> IndexArray:
    """Return the indices (c,) of the states that two runs have in common."""
    common = {group.name for group in GROUPS if group.is_repeated}
    common |= {"base"} & set(problem.unknown)
    kinds = [name.partition(".")[0] for name in problem.names]
    return np.array([k for k, kind in enumerate(kinds) if kind in common], dtype=np.intp)


def with_reference(
    problem: Problem, method: str, blocks: Sequence[Block], gate_probability: float
) -> Problem:
    """Return the problem whose prior includes what the reference shows of arm and calibration.

    Raises
    ------
    EstimatorError if the reference's blocks do not fit the robot without its unknown bodies, or if
    there is no block.
    """
    if not blocks:
        raise EstimatorError("the reference holds no usable block")
    empty = without_bodies(problem)
    linear = Linearisation(row_function(method, "eiv", empty), blocks)
    try:
        found = settle(empty, linear, blocks, gate_probability, None, None)
    except NUMERICAL as error:
        raise EstimatorError(f"the reference cannot be solved: {unforeseen(error)}") from error
    solution = found.solution
    if solution.status not in ("OK", "INSUFFICIENT_EXCITATION"):
        raise EstimatorError(f"the reference ended with {solution.status}")
    if found.mismatch or problem.least_plausible(solution.mean)[1] > IMPLAUSIBLE:
        raise EstimatorError(
            "the reference does not fit the robot without its unknown bodies: MODEL_MISMATCH"
            + f"; {found.against}" * found.mismatch
            + problem.suspicion(solution.mean)
            + _remedy(problem, linear(solution.mean))
        )
    k = repeated(problem)
    own = np.ix_(k, k)
    mean, covariance = problem.prior_mean.copy(), problem.prior_covariance.copy()
    mean[k], covariance[own] = solution.mean[k], found.covariance[own]
    covariance[k, k] += (_drift(problem)[k] * mean[k]) ** 2
    return replace(problem, prior_mean=mean, prior_covariance=covariance)


def _drift(problem: Problem) -> FloatArray:
    """Return the share (p,) of its size by which each state differs between two runs."""
    groups = [group_of(name) for name in problem.names]
    return np.array([0.0 if group is None else group.drift for group in groups])


def _remedy(problem: Problem, rows: Collection[Rows]) -> str:
    """Return which torque fits worst, by how much, and what to declare; empty: no torque is off."""
    n = problem.model.n
    nodes = [one.at_nodes for one in rows if one.torques >= n > 0]
    whole = [(one.b, one.root) for one in nodes if one.root is not None]
    if not whole:
        return ""
    white = np.concatenate([b.reshape(problem.nodes, -1)[:, :n] for b, _ in whole])
    left = [(root @ b).reshape(problem.nodes, -1)[:, :n] for b, root in whole]
    k = int(np.argmax(np.mean(white**2, axis=0)))
    rms_nm = float(np.sqrt(np.mean(np.concatenate(left)[:, k] ** 2)))
    name, unit = list(problem.model.torque_units.items())[k]
    what, key = ("force", "force_model_sigma_n") if unit == "N" else ("torque", TORQUE_MODEL)
    return (
        f"; the {what} of {name} fits worst: residuals of {rms_nm:.2g} {unit}, "
        f"{np.sqrt(np.mean(white[:, k] ** 2)):.2g} times the declared noise; if the arm is empty, "
        f"declare {key}: {rms_nm:.2g} there, or its friction"
    )
