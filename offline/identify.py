"""Batch identification of a recording: a replay makes the blocks, then one batch method runs."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fsw.clock import MonotonicClock
from fsw.config import Config
from fsw.errors import EstimatorError
from fsw.estimators.batch.run import run_batch
from fsw.estimators.batch.screening import fits_throughout, lacks_more, screened
from fsw.estimators.block_view import BlockView
from fsw.estimators.conditioning.plausible import plausible
from fsw.estimators.measurement.mrnea import Rows
from fsw.estimators.model.building import build_problem, joint_order, robot_of
from fsw.estimators.model.problem import Problem
from fsw.estimators.pipeline import Pipeline
from fsw.estimators.recursive.online import build_online
from fsw.exchange.sinks import Fanout
from fsw.messages import Block, Estimate, FloatArray
from offline.check_recording import contradictions
from offline.checks.comparison import WRONG
from offline.checks.wiring import Wires
from offline.holdout import judge, split, unpredicted
from offline.holdout import to_text as holdout_text
from offline.nodes import Nodes
from offline.replay import replay
from offline.replay_result import ReplayResult, in_words, known_by, with_sigma
from offline.report.collect import Collector
from offline.shelf import Shelf
from offline.span import WHOLE, Span
from offline.unused import missed, unused_sensors
from offline.watching import MOST_KEPT, Watching

Progress = Callable[[float, str], bool]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """Data behind a batch result, for its page."""

    replayed: ReplayResult
    blocks: Sequence[Block]  # of all plausible windows of the recording
    recursive: Sequence[Estimate]  # recursive estimates of the replay that made the blocks
    problem: Problem
    x: FloatArray  # (p,) the whole state
    covariance: FloatArray  # (p, p) of x


def identify(
    recording: Path,
    config: Config,
    method: str,
    unknown: tuple[str, ...],
    progress: Progress | None = None,
    span: Span = WHOLE,
    holdout: float | None = None,
    reference: Path | None = None,
    show: Callable[[Mapping[str, Any], Evidence], None] | None = None,
) -> dict[str, Any]:
    """Identify bodies from a recording by one batch method.

    `reference` is a recording of the same robot with all unknown bodies but the base removed.
    `holdout` is the share of the windows to hold out and predict; None: all are used. `show` is
    called with the result and its evidence. If these three are None and outside_wrench is ignore,
    the recursive estimator runs only when a part of the data does not fit the batch result.

    Returns
    -------
    Plain values: method, unknown, status (OK or the reason why not), estimate and sigma per body,
    names, mean and covariance of the published states, diagnosis, samples per source and others;
    docs/output.md describes every field.

    Raises
    ------
    ConfigError if recording and configuration do not fit; EstimatorError if no window can be used.
    """

    def tell(text: str) -> None:
        if progress is not None:
            progress(0.0, text)

    clock = MonotonicClock()
    began_ns = clock.now_ns()
    chosen = config.with_unknown(unknown) if unknown else config
    collector = Collector()
    tell(f"reading {recording}")
    alone = show is None and holdout is None and reference is None
    windows_only = alone and chosen.estimator.outside_wrench == "ignore"
    result, warnings, one_sensor = _read(
        recording, chosen, collector, span, tell, windows_only=windows_only
    )
    if lines := missed(result.status, chosen, method):
        raise EstimatorError(f"{recording}: {'; '.join(lines)}")
    wrong = unused_sensors(result.status) or any(WRONG in line for line in warnings)
    names = tuple(chosen.unknown)
    empty = Collector()
    if reference is not None:
        tell(f"reading {reference}")
        replay(reference, chosen, sink=empty, progress=tell)
        if not empty.blocks:
            raise EstimatorError("--reference: no window in this recording")
    state: list[tuple[Problem, FloatArray, FloatArray, Collection[Rows]]] = []

    def keep(
        problem: Problem, x: FloatArray, covariance: FloatArray, fused: Collection[Rows]
    ) -> None:
        state.append((problem, x, covariance, fused))

    if holdout is None:
        values = run_batch(
            chosen, collector.blocks, method, names, progress, keep, reference=empty.blocks
        )
        unscreened = alone and result.estimate is None and values["status"] != "ABORTED"
        unscreened &= one_sensor or values["status"] != "MODEL_MISMATCH"
        if unscreened and not fits_throughout(chosen, collector.blocks, values, *state[0]):
            tell("checking single readings of every sensor; those that do not fit are left out")
            every, collector.blocks = collector.blocks, Shelf(screened(chosen, collector.blocks))
            if lacks_more(every, collector.blocks):  # otherwise the result would be the same
                values = run_batch(chosen, collector.blocks, method, names, progress, keep)
    else:
        blocks = _plausible(collector.blocks)
        used, held = split(blocks, holdout)
        judged: dict[str, Any] = {}

        def predict(problem: Problem, x: FloatArray, covariance: FloatArray) -> str:
            try:
                judged.update(judge(blocks, held, problem, x, covariance))
            except ValueError as error:  # LinAlgError: the base has no inertia at the estimate
                raise EstimatorError(f"--holdout: nothing can be predicted: {error}") from error
            return unpredicted(judged)

        values = run_batch(chosen, used, method, names, progress, keep, empty.blocks, predict)
        values |= {"holdout": judged | {"passed": judged["passed"] and not wrong}}
    values |= {
        "samples": result.status["samples"],
        "truncated": result.truncated,
        "warnings": warnings,
        "frames": {name: frame_of(chosen, name) for name in names},
        "wall_s": (clock.now_ns() - began_ns) * 1e-9,
    }
    if show is not None:
        tell("writing the page: residuals and what limits the accuracy")
        problem, x, covariance, _ = state[0]
        show(
            values,
            Evidence(
                replayed=result,
                blocks=_plausible(collector.blocks),
                recursive=collector.estimates,
                problem=problem,
                x=x,
                covariance=covariance,
            ),
        )
    return values


def _read(
    recording: Path,
    config: Config,
    collector: Collector,
    span: Span,
    tell: Callable[[str], None],
    *,
    windows_only: bool,
) -> tuple[ReplayResult, list[str], bool]:
    """Replay a recording into the collector; return the result, and what does not fit the data.

    Also return whether the data may fit if one sensor is left out.

    Raises
    ------
    EstimatorError if no window can be used.
    """
    nodes, wires = Nodes(config), Wires(config)
    model = robot_of(config)
    watching = Watching(config, joint_order(config, model), most=MOST_KEPT)
    result = replay(
        recording,
        config,
        sink=collector,
        pipeline=Pipeline(conditioner=watching, estimator=build_online(config, model)),
        span=span,
        traffic=Fanout(nodes, wires),
        progress=tell,
        windows_only=windows_only,
    )
    wired, fits = wires.lines()
    warnings = [*result.warnings(), *nodes.findings(), *(own for own in wired if WRONG in own)]
    if not any(map(plausible, collector.blocks)):
        why = warnings or ["fsw check CONFIG RECORDING says why"]
        raise EstimatorError(f"{recording}: no window can be used; {'; '.join(why)}")
    tell("comparing the data with the configuration")
    problem, one_sensor = build_problem(config, model), True
    if fits:  # times and values of all samples follow from it
        rates = wires.rates()
        wrong, one_sensor = contradictions(recording, config, problem, result, watching, rates)
        warnings += wrong
    return result, warnings, one_sensor


def frame_of(config: Config, body: str) -> str:
    """Return the name of the frame in which a body's parameters are stated."""
    own = {"base": "base", "target": config.robot.tool_frame}
    return own.get(body) or str(config.bodies[body].frame)


def _plausible(recorded: Sequence[Block]) -> Sequence[Block]:
    places = {block.index: k for k, block in enumerate(recorded) if plausible(block)}
    return BlockView(recorded, places.values())


def noise_text(result: Mapping[str, Any]) -> list[str]:
    """Return a line for each sensor whose noise is correlated in time."""
    torques = result.get("torque_noise", ())
    others = (*result.get("wrench_noise", ()), *result.get("inertial_noise", ()))
    found = [
        *((_torque_noise(s), s) for s in torques),
        *((f"noise of the {s['channel']}: {s['sigma']:.3g} {s['unit']}", s) for s in others),
    ]
    return [
        f"{words}, correlated over {1e3 * s['correlation_s']:.3g} ms; {s['samples']} samples count "
        f"as {s['effective_samples']:.0f}"
        for words, s in found
        if s["correlation_s"] > 0.0
    ]


def _torque_noise(noise: Mapping[str, Any]) -> str:
    """Return joint and 1 sigma of a torque, or of a prismatic joint's force."""
    if "sigma_n" in noise:
        return f"force noise of {noise['joint']}: {noise['sigma_n']:.3g} N"
    return f"torque noise of {noise['joint']}: {noise['sigma_nm']:.3g} N m"


def to_text(result: Mapping[str, Any]) -> str:
    """Return the result of `identify` as a short table."""
    state = in_words(result["reasons"])
    lines = [f"{result['method']}, unknown {', '.join(result['unknown'])}: {state}"]
    if {"NOT_CONVERGED", "MODEL_MISMATCH", "PRIOR_CONFLICT"}.intersection(result["reasons"]):
        lines.append("to find why: fsw check CONFIG RECORDING names the usual mistakes")
    if "INSUFFICIENT_EXCITATION" in result["reasons"] and "TOO_FEW_BLOCKS" not in result["reasons"]:
        lines.append(
            "the data hardly narrow the prior of some combination of parameters: know the arm "
            "better (--reference EMPTY, robot.links_sigma_ratio) or move more (of a free base: "
            "fsw excite)"
        )
    if result.get("note"):
        lines.append(f"note: {result['note']}")
    lines += [
        line.replace("nothing usable", "NOTHING USABLE") for line in result.get("warnings", ())
    ]
    for body, estimate in result["estimate"].items():
        for key, mean in estimate.items():
            lines.append(f"{body}.{key}: {with_sigma(mean, result['sigma'][body][key])}")
        lines += known_by(result["diagnosis"], body)
    diagnosis = result["diagnosis"]
    if diagnosis is not None:
        lines += list(diagnosis["verdict"].values())
    if diagnosis is not None and "NOT_CONVERGED" not in result["reasons"]:
        efficiency = diagnosis["efficiency_volume"]
        lines.append(f"efficiency {efficiency:.3g}; 1 is the Cramer-Rao bound of all sensors")
    lines += noise_text(result)
    if result.get("holdout"):
        lines += holdout_text(result["holdout"])
    lines += result.get("input", ())
    lines.append(f"iterations {result['iterations']}, wall {result['wall_s']:.1f} s")
    return "\n".join(lines)
