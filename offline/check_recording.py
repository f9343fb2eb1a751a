"""`fsw check CONFIG RECORDING`: compare a configuration with the data of a recording."""

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from fsw.config import Config
from fsw.config.signals import DESCRIBED
from fsw.estimators.model.building import joint_order
from fsw.estimators.model.problem import Problem
from fsw.estimators.pipeline import Pipeline
from fsw.estimators.recursive.online import build_online
from fsw.exchange.recording_parts import contents_of, parts_of
from fsw.exchange.sinks import IMU, STAR_TRACKER, Fanout, Sink
from offline.checks.comparison import WRONG, Comparison, with_found
from offline.checks.exact import exact_risks
from offline.checks.explanation import LARGE, Verdict, explain_residuals, unexplained
from offline.checks.recorded import (
    data_findings,
    poses_count,
    range_findings,
    tracker_findings,
    with_wide_limits,
)
from offline.checks.trial import make_trial
from offline.checks.wiring import Wires
from offline.nodes import Nodes
from offline.replay import replay, topics_of
from offline.replay_result import ReplayResult
from offline.span import WHOLE, Span
from offline.stamp_checks import stamp_findings
from offline.unused import unused_sensors
from offline.watching import MOST_KEPT, Watching

FEW_BLOCKS = 3
NOTHING = 1e-16  # squared residuals over noise below which no channel has a residual
ALL_FITS = "signs, order of joints, mounting of the inertial unit"


def check_recording(
    recording: Path,
    config: Config,
    problem: Problem,
    progress: Callable[[str], None],
    span: Span = WHOLE,
) -> tuple[list[str], bool]:
    """Return one line for each finding, and whether the data agree with the configuration.

    Raises
    ------
    ConfigError when the recording cannot be replayed with this configuration.
    """
    progress(f"reading {recording}")
    nodes, wires = Nodes(config), Wires(config)
    traffic = Fanout(nodes, wires)
    result, watching = _read(recording, config, problem, span, progress, traffic)
    wired, fits = wires.lines()
    if not fits:  # times and values of all samples follow from it
        return wired, False
    lines = [*nodes.findings(), *_jumps(recording, config, watching)]
    wrong = bool(lines)
    if result.truncated:
        lines.append(result.cut_off())
    unused = unused_sensors(result.status)
    lines += [
        f"{WRONG}{source}: {words}{_advice(source, result.status, config)}"
        for source, words in unused.items()
    ]
    wrong |= bool(unused)
    counts = result.status["samples"]
    if ranged := range_findings(config, counts):
        progress("reading it again without limits")
        wide = with_wide_limits(config)
        watching = _read(recording, wide, problem, span, progress, None)[1]
    lines += [f"{WRONG}{text}" for text in ranged]
    found = data_findings(config, watching.windows, counts, result.duration_s, wires.rates())
    lines += found.lines()
    if len(watching.made) < FEW_BLOCKS:
        used = f"{len(watching.made)} of {len(watching.windows)} windows can be used"
        words = "too few to judge signs and mounting; look at rates, lost samples and channels"
        return [*lines, f"{WRONG}{used}: {words}"], False
    if not config.joints:
        return lines, not (wrong or ranged or found.wrong)
    judged = with_found(config, found.noise)
    trial = make_trial(judged, problem.model, watching.windows, watching.made)
    blocks = watching.made if judged is config else trial.blocks
    verdict = explain_residuals(trial, blocks, progress)
    told = list(dict.fromkeys([*verdict.found, *filter(None, [verdict.mounting])]))
    mounted = any(text.startswith("imu") for text in told)
    turned = [] if mounted or wrong else tracker_findings(config, watching.windows)
    lines += [f"{WRONG}{text}" for text in [*turned, *told]]
    lines += [f"doubtful: {text}" for text in filter(None, [verdict.doubtful])]
    lines += exact_risks(trial)
    lines.append(_residual_words(verdict, config))
    is_small = NOTHING <= verdict.before <= LARGE
    return lines, is_small and not (wrong or ranged or found.wrong or turned or told)


def verdict_line(recording: Path, config: Config, agree: bool) -> str:
    """Return the last line of the findings."""
    verdict = "agree" if agree else "do not agree; see the lines with WRONG"
    return f"{recording} and {config.name} {verdict}"


def contradictions(
    recording: Path,
    config: Config,
    problem: Problem,
    result: ReplayResult,
    watching: Watching,
    rates: Sequence[Comparison],
) -> tuple[list[str], bool]:
    """Return the lines of `check_recording` on what is wrong, without a long search for a cause.

    Also return whether the data may fit if one sensor is left out.

    `result` and `watching` are of a replay, `rates` those of the frames of described joints. Wrong
    nodes and unused sensors are not among the lines.
    """
    counts = result.status["samples"]
    data = data_findings(config, watching.windows, counts, result.duration_s, rates)
    jumps = _jumps(recording, config, watching)
    turned = [] if jumps else tracker_findings(config, watching.windows)
    lines = [*jumps, *data.wrong]
    lines += [f"{WRONG}{text}" for text in [*range_findings(config, counts), *turned]]
    if len(watching.made) < FEW_BLOCKS or not config.joints:
        return lines, True
    trial = make_trial(
        with_found(config, data.noise), problem.model, watching.windows, watching.made
    )
    found = unexplained(trial)
    words = found.words
    if found.level > LARGE:
        cause = "; ".join(words) or "fsw check CONFIG RECORDING looks for the cause"
        words = (f"residuals {found.level**0.5:.3g} times the declared noise; {cause}",)
    return [*lines, *(f"{WRONG}{text}" for text in words)], found.one_sensor


def _jumps(recording: Path, config: Config, watching: Watching) -> list[str]:
    """Return a line for clocks that were set, and one for missing data; none for static poses."""
    if poses_count(watching.windows):
        return []
    parts = parts_of(recording)
    found = stamp_findings(parts, topics_of(config, contents_of(parts).topics))
    return [f"{WRONG}{text}" for text in found]


def _read(
    recording: Path,
    config: Config,
    problem: Problem,
    span: Span,
    progress: Callable[[str], None],
    traffic: Sink | None,
) -> tuple[ReplayResult, Watching]:
    """Replay a recording without estimating; return the result, and its windows and blocks."""
    order = joint_order(config, problem.model)
    watching = Watching(config, order, alone=True, most=MOST_KEPT)
    pipeline = Pipeline(conditioner=watching, estimator=build_online(config, problem.model))
    result = replay(
        recording, config, pipeline=pipeline, span=span, traffic=traffic, progress=progress
    )
    return result, watching


def _advice(source: str, status: Mapping[str, Any], config: Config) -> str:
    """Return what the user should look at, unless it is known what the device does not send."""
    counts = status["samples"][source]
    if source in status["lacks"] or counts["accepted"]:
        return ""
    if any(bus.name == source and bus.feed is not None for bus in config.buses):
        return "; compare buses[].feed and the number of joints with the sender's datagrams"
    devices = {at: own for at, own in config.bus_devices.items() if source in (at, own.bus)}
    joints = {at: own for at, own in devices.items() if at.startswith("joints.")}
    for at, own in (joints or devices).items():
        if own.driver == DESCRIBED:
            key = re.sub(r"\.\d+", "[]", at)
            return f"; compare {key}.signals and {key}.timing with the frames on its bus"
    if source not in (IMU, STAR_TRACKER):
        return "; compare node numbers and format of joints[] with the nodes"
    if not counts["received_bytes"]:
        return "; was it switched on, and its port right?"
    return f"; compare {source}.baud_rate and {source}.driver with the device"


def _residual_words(verdict: Verdict, config: Config) -> str:
    level = f"residuals {verdict.before**0.5:.3g} times the declared noise"
    after = f"{verdict.after**0.5:.3g} times"
    if verdict.is_sign:
        return level
    if verdict.before <= LARGE:
        fits = "signs, order of joints" if verdict.mounting else ALL_FITS
        if verdict.before < NOTHING:
            return f"{WRONG}{fits}: not judged; no torque, rate or specific force is used"
        return f"{fits}: fit ({level})"
    if verdict.found:
        return f"{level}, {after} with these changes"
    lever = "the lever arm imu.mounting.p_BS_m, " if config.imu.present else ""
    near = f" (nearest, {after}: {'; '.join(verdict.nearest)})" if verdict.nearest else ""
    return (
        f"{WRONG}{level}, and none of {verdict.tried} usual mistakes explains them{near}; is it a "
        "recording of this robot and base? Look at the masses of the links (kg), the priors of "
        f"bodies, zero offsets, {lever}delays, the tool frame"
    )
