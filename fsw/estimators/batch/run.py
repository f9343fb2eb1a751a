"""One batch identification of recorded blocks, from configuration to plain values.

Invalid and repeated blocks are left out first. Blocks whose residuals noise does not explain are
left out next, and the rest is solved again; sigmas follow the residuals where these are clearly
above the declared noise. A group of the prior that the data contradict is widened; the result is
not valid if it is a sensor, a known body or a mounting. If the residuals are larger still, or if
they drift, the model does not fit. Every reason against the result is kept. The paper's regressions
are compared with the errors in variables on the same blocks, and their sigma includes the distance.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fsw.config import Config
from fsw.config.consistency import delays_of, method_takes_delays
from fsw.config.modes import METHODS_MODES
from fsw.config.robot import METHODS_HELD
from fsw.errors import NUMERICAL, ConfigError, EstimatorError, unforeseen
from fsw.estimators.batch.diagnosis import diagnose_batch
from fsw.estimators.batch.plain import BatchSolution
from fsw.estimators.batch.reference import with_reference
from fsw.estimators.batch.settle import settle
from fsw.estimators.batch.solver import (
    Progress,
    Target,
    linear_covariance,
    minimise,
    regress,
    straighten,
)
from fsw.estimators.block_view import BlockView, changed
from fsw.estimators.conditioning.plausible import plausible
from fsw.estimators.measurement.first_rate import at_first_rate
from fsw.estimators.measurement.mrnea import Rows
from fsw.estimators.measurement.row_functions import (
    Linearisation,
    row_function,
    stack,
    watched_rows,
)
from fsw.estimators.model.building import build_problem, robot_of
from fsw.estimators.model.problem import IMPLAUSIBLE, Problem
from fsw.estimators.noise.few_windows import too_few
from fsw.estimators.noise.sensors import SensorNoise
from fsw.estimators.publish import body_estimate, whole_estimate
from fsw.estimators.reasons import Failed, is_displaced, reasons
from fsw.estimators.recursive.outcome import WEAKEST_GAIN, weakest_gain
from fsw.estimators.recursive.prior_groups import Widened, in_words, widen
from fsw.messages import Block, BodyEstimate, FloatArray

# problem, mean (p,), covariance (p, p), fused rows of the blocks used at the mean
Keep = Callable[[Problem, FloatArray, FloatArray, Collection[Rows]], None]
# the same without the rows; returns what contradicts the estimate, empty if nothing does
Predict = Callable[[Problem, FloatArray, FloatArray], str]
CURVED = ("cm", "ce")  # methods whose likelihood is curved along the bodies' common scale
NEED_EVERY_TORQUE = ("mrnea", "ce")
WARM = ("rda", "ce")  # methods that need a good start: they begin at the linear method's result
WARM_BLOCKS = 32  # least number for RDA's start, which need only be near; all if there are fewer
WIDENINGS = 6  # rounds: first of bodies, which constrain one another, then of the rest of the model
SETTLED = ("OK", "INSUFFICIENT_EXCITATION")
BIASED = (
    "the bodies are shrunk by the noise of the base's acceleration; sigma includes the distance "
    "from the result with weighting eiv, which has no such error"
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Found:
    """A solution and the judgement of it."""

    problem: Problem  # with the prior of this solution
    solution: BatchSolution
    failed: Failed  # checks so far; the number of blocks and possible bodies are checked later
    mean: FloatArray  # (p,)
    covariance: FloatArray  # (p, p)
    note: str
    biased: bool
    level: float  # ratio of the noise's variance to the declared one
    used: Sequence[Block]
    residuals: Sequence[FloatArray]  # whitened, block by block


def run_batch(
    config: Config,
    blocks: Sequence[Block],
    method: str,
    unknown: Sequence[str],
    progress: Progress | None = None,
    keep: Keep | None = None,
    reference: Sequence[Block] = (),
    predict: Predict | None = None,
) -> dict[str, Any]:
    """Identify `unknown` from stored blocks; return plain values for worker, shell and adoption.

    `reference` are blocks of the same robot without its unknown bodies, except the base; they show
    arm and calibration. `keep` is called with the problem, mean and covariance of the whole state,
    published or not, and the rows of all sensors at the mean; no rows if nothing can be predicted.
    `predict` judges the estimate by data that it was not made from.

    Raises
    ------
    EstimatorError if there is no usable block or no such method, or if arithmetic fails on these
    blocks; ConfigError if a body has no prior, and for a delay with ce.
    """
    try:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            return _run(config, blocks, method, unknown, progress, keep, reference, predict)
    except (ConfigError, EstimatorError):
        raise
    except NUMERICAL as error:
        words = "nothing can be identified from these blocks: arithmetic fails"
        raise EstimatorError(f"{words} ({unforeseen(error)})") from error


def _run(
    config: Config,
    blocks: Sequence[Block],
    method: str,
    unknown: Sequence[str],
    progress: Progress | None,
    keep: Keep | None,
    reference: Sequence[Block],
    predict: Predict | None,
) -> dict[str, Any]:
    sound = _measured(blocks)
    held = METHODS_HELD.get(config.base.motion, (method,))
    if method not in held:
        raise EstimatorError(
            f"method {method!r} needs a free base; base.motion is {config.base.motion}: "
            f"{' or '.join(held)}"
        )
    if not config.joints and method != "mrnea":
        raise EstimatorError(f"method {method!r} needs joints; a body without has mrnea")
    blind = [joint.name for joint in config.joints if joint.torque == "none"]
    if blind and method in NEED_EVERY_TORQUE:
        raise EstimatorError(
            f"method {method!r} needs the torque of every joint; {blind[0]!r} has torque: none"
        )
    turning = [joint.name for joint in config.joints if joint.speed_only]
    if turning and (method in NEED_EVERY_TORQUE or reference):
        what = "a reference" if reference else f"method {method!r}"
        raise EstimatorError(
            f"{what} needs the position of every joint; {turning[0]!r} has encoder: speed"
        )
    method_takes_delays(method, delays_of(config.joints, config.buses, config.imu))
    if config.modes and (method not in METHODS_MODES or reference):
        what = "a reference" if reference else f"method {method!r}"
        raise EstimatorError(f"{what} knows no modes: {' or '.join(METHODS_MODES)}, without one")
    chosen = config.with_unknown(tuple(unknown)) if unknown else config
    model = robot_of(config)
    settings = config.estimator
    weighting = settings.weighting if method == "mrnea" else "eiv"
    exact = weighting != "eiv" or method == "ce"
    if reference and exact:
        raise EstimatorError(
            f"{method!r} {settings.weighting} takes arm and calibration as exact, "
            "which a reference is to show: fused, rda, cm or mrnea eiv"
        )
    problem = build_problem(chosen, model, exact=exact, blocks=sound)
    sound, noise = with_noise_found(problem, sound)
    if reference:
        empty = with_noise_found(problem, sound_blocks(reference))[0]
        problem = with_reference(problem, method, empty, settings.gate_probability)
    if weighting == "eiv":
        found = _likelihood(problem, method, sound, settings.gate_probability, progress)
    else:
        found = _regression(problem, weighting, sound, settings.gate_probability, progress)
    problem = found.problem
    covariance = found.covariance + problem.liquid
    fused: Collection[Rows]
    try:
        fused = stack(row_function("fused", "eiv", problem), found.used, found.mean)
    except ValueError:  # LinAlgError: no inertia at the estimate
        fused = []
    if keep is not None:
        keep(problem, found.mean, covariance, fused)
    unpredicted = "" if predict is None else predict(problem, found.mean, covariance)
    made = {name: body_estimate(problem, name, found.mean, covariance) for name in problem.unknown}
    bodies = {name: body for name, (body, _) in made.items()}
    condition = found.solution.information.scaled_condition_number()
    count = len(sound if found.failed.misfit else found.used)
    few = too_few(count, settings.settle_blocks)
    against = reasons(
        replace(
            found.failed,
            few_blocks=bool(few),
            mismatch=found.failed.mismatch or bool(unpredicted),
            displaced=is_displaced([distance for _, distance in made.values()]),
            not_excited=found.failed.not_excited or condition > settings.condition_limit,
        )
    )
    whole = whole_estimate(problem, found.mean, covariance, found.used[-1].q_rad[-1])
    return {
        "method": method,
        "unknown": list(problem.unknown),
        "status": next(iter(against), "OK"),
        "reasons": list(against),
        "biased": found.biased,
        "note": "; ".join(filter(None, (few, unpredicted, found.note))),
        "iterations": found.solution.iterations,
        "cost": found.solution.cost,
        "rows": sum(map(len, found.residuals)),
        "gated": len(blocks) - len(found.used),
        "condition_number": condition,
        "duration_s": len(found.used) * config.estimator.window_s,
        "names": [problem.names[k] for k in problem.published],
        "mean": found.mean[problem.published].tolist(),
        "covariance": covariance[np.ix_(problem.published, problem.published)].tolist(),
        "first_block": sound[0].index,
        "last_block": sound[-1].index,
        "estimate": {name: _plain(body, "") for name, body in bodies.items()},
        "sigma": {name: _plain(body, "sigma") for name, body in bodies.items()},
        "whole": _plain(whole, "") | {"sigma": _plain(whole, "sigma")},
        **noise.report(model.torque_units, model.n),
        "diagnosis": diagnose_batch(
            problem,
            fused,
            found.residuals,
            found.used,
            found.mean,
            covariance,
            bodies,
            found.level,
            against,
        ),
    }


def _measured(blocks: Sequence[Block]) -> Sequence[Block]:
    """Return the plausible blocks. Raises EstimatorError if nothing was measured in any."""
    sound = sound_blocks(blocks)
    if not sound:
        raise EstimatorError("no usable block recorded in this window")
    if all(block.is_empty for block in sound):
        raise EstimatorError("no window has a torque, rate or specific force that could be used")
    return sound


def sound_blocks(blocks: Sequence[Block]) -> Sequence[Block]:
    """Return the plausible blocks in order of their index, each index once."""
    places: dict[int, int] = {}
    for place, block in enumerate(blocks):
        if plausible(block):
            places.setdefault(block.index, place)
    return BlockView(blocks, (places[index] for index in sorted(places)))


def with_noise_found(
    problem: Problem, blocks: Sequence[Block]
) -> tuple[Sequence[Block], SensorNoise]:
    """Return the blocks with the noise that is found in them added, and this noise."""
    noise = SensorNoise(
        problem.noise_declared,
        problem.noise_samples,
        problem.window_s,
        problem.nodes,
        problem.torque_model_nm2,
    )
    for block in blocks:
        noise.note(block)
    noise.learn()
    return changed(blocks, noise.applied), noise


def _likelihood(
    problem: Problem,
    method: str,
    blocks: Sequence[Block],
    gate_probability: float,
    progress: Progress | None,
) -> _Found:
    """Maximise the likelihood of blocks that fit; widen the prior where the data contradict it."""
    stated, contradicted = problem, False
    conflicts: list[Widened] = []
    linear = Linearisation(row_function(method, "eiv", problem), blocks)
    rows = watched_rows(problem) if method == "fused" else None
    watch = None if rows is None else Linearisation(rows, blocks)
    start = problem.prior_mean
    if method in WARM:
        start = _warm_start(problem, method, blocks, gate_probability)
    first = next((block for block in blocks if block.has_gyro and block.has_attitude), blocks[0])
    start = at_first_rate(first, start, problem)
    for more in reversed(range(WIDENINGS)):
        settled = settle(problem, linear, blocks, gate_probability, progress, start, watch)
        solution = settled.solution
        if solution.status == "ABORTED" or method in CURVED:
            break
        prior = problem.prior_mean, problem.prior_covariance
        estimate = solution.mean, settled.likely  # where a prior is wrong, sensors seem to creep
        wider, found = widen(stated, prior, estimate, bodies_first=True)
        unfit = settled.misfit or solution.status == "NOT_CONVERGED"
        if unfit and any(group.of_model for group in found):
            break
        conflicts += found
        if more == 0 or all(group.factor == 1.0 for group in found):
            contradicted = bool(found)
            break
        problem, start = replace(problem, prior_covariance=wider), solution.mean
    doubted = contradicted or any(group.of_model for group in conflicts)
    implausible = stated.least_plausible(solution.mean)[1] > IMPLAUSIBLE
    known = weakest_gain(problem, problem.prior_covariance, settled.covariance)
    weak = bool(settled.note) and known < WEAKEST_GAIN
    not_excited = solution.status == "INSUFFICIENT_EXCITATION" or weak
    covariance, note = linear_covariance(problem, method, "eiv", solution, settled.covariance)
    if method in CURVED and solution.status in SETTLED:
        looked = straighten(problem, settled.target, solution)
        note = looked.note
        covariance = looked.covariance + settled.covariance - solution.information.covariance()
        not_excited = not_excited or not looked.bounded
    notes = (
        note,
        settled.against,
        solution.note * (solution.note not in settled.against),
        settled.note,
        in_words(conflicts),
        stated.suspicion(solution.mean).removeprefix("; "),
    )
    return _Found(
        problem=problem,
        solution=solution,
        failed=Failed(
            aborted=solution.status == "ABORTED",
            not_converged=solution.status == "NOT_CONVERGED",
            misfit=settled.misfit,
            mismatch=settled.mismatch or implausible,
            prior_conflict=doubted,
            not_excited=not_excited,
        ),
        mean=solution.mean,
        covariance=covariance,
        note="; ".join(filter(None, notes)),
        biased=bool(note) and method in CURVED,
        level=settled.level,
        used=settled.used,
        residuals=settled.residuals,
    )


def _warm_start(
    problem: Problem, method: str, blocks: Sequence[Block], gate_probability: float
) -> FloatArray:
    """Return another method's result as a start: for RDA of all channels of some of the blocks.

    For CE, whose likelihood is curved, the linear method has all blocks, so that it ends nearer to
    the minimum.
    """
    some = blocks[:: max(1, len(blocks) // WARM_BLOCKS)] if method == "rda" else blocks
    rows = row_function("fused" if method == "rda" else "mrnea", "eiv", problem)
    near = minimise(problem, Target(Linearisation(rows, some)))
    if near.status == "NOT_CONVERGED":  # blocks that do not fit may be why
        return _likelihood(problem, "mrnea", blocks, gate_probability, None).mean
    return near.mean


def _regression(
    problem: Problem,
    weighting: str,
    blocks: Sequence[Block],
    gate_probability: float,
    progress: Progress | None,
) -> _Found:
    """Solve the paper's regression; its bias is the distance from the errors in variables."""
    near = _likelihood(problem, "mrnea", blocks, gate_probability, progress)
    problem, used, x = near.problem, near.used, near.mean
    linear = Linearisation(row_function("mrnea", weighting, problem), used)
    solution = regress(problem, Target(linear))
    mean = solution.mean
    bias = mean - x
    failed = replace(near.failed, not_converged=solution.status == "NOT_CONVERGED")
    return replace(
        near,
        solution=solution,
        failed=failed,
        mean=mean,
        residuals=[part.b.copy() for part in linear(mean)],
        covariance=near.covariance + np.outer(bias, bias),
        note=BIASED,
        biased=True,
    )


def _plain(body: BodyEstimate, kind: str) -> dict[str, Any]:
    if kind:
        mass, com, inertia = body.mass_sigma_kg, body.com_sigma_m, body.inertia_sigma_kg_m2
    else:
        mass, com, inertia = body.mass_kg, body.com_m, body.inertia_kg_m2
    return {"mass_kg": mass, "com_m": com.tolist(), "inertia_kg_m2": inertia.tolist()}
