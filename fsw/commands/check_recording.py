"""`fsw check CONFIG RECORDING`: compare a configuration with the data of a recording."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from fsw.checks.mistakes import LARGE, Verdict, explain_residuals
from fsw.checks.recorded import noise_findings, poses_count, rate_findings, tracker_findings
from fsw.commands.nodes import Nodes
from fsw.commands.replay import replay, topics_of
from fsw.commands.span import WHOLE, Span
from fsw.commands.stamp_checks import stamp_findings
from fsw.commands.unused import unused_sensors
from fsw.commands.watching import Watching
from fsw.config import Config
from fsw.estimators.model.building import joint_order
from fsw.estimators.model.problem import Problem
from fsw.estimators.pipeline import Pipeline
from fsw.estimators.recursive.online import build_online
from fsw.exchange.recording_parts import contents_of, parts_of
from fsw.exchange.sinks import IMU, STAR_TRACKER

FEW_BLOCKS = 3
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
    watching = Watching(config, joint_order(config, problem.model), alone=True)
    pipeline = Pipeline(conditioner=watching, estimator=build_online(config, problem.model))
    progress(f"reading {recording}")
    nodes = Nodes(config)
    result = replay(
        recording, config, pipeline=pipeline, span=span, traffic=nodes, progress=progress
    )
    parts, poses = parts_of(recording), poses_count(watching.windows)
    jumps = [] if poses else stamp_findings(parts, topics_of(config, contents_of(parts).topics))
    lines = [*nodes.findings(), *(f"WRONG: {jump}" for jump in jumps)]
    wrong = len(lines)
    if poses:
        lines.append(
            f"{poses} static poses of one window each: their noise and clock are not judged"
        )
    if result.truncated:
        lines.append(result.cut_off())
    unused = unused_sensors(result.status)
    lines += [
        f"WRONG: {source}: {words}{_advice(source, result.status)}"
        for source, words in unused.items()
    ]
    wrong += len(unused)
    datagrams = result.status["samples"].get("imu", {"received": 0})["received"]
    findings = rate_findings(config, watching.windows, datagrams) if watching.windows else []
    if len(watching.made) >= FEW_BLOCKS and not poses:
        findings += noise_findings(config, watching.windows)
    lines += [finding.text() for finding in findings]
    wrong += sum(bool(finding.wrong) for finding in findings)
    if len(watching.made) < FEW_BLOCKS:
        used = f"{len(watching.made)} of {len(watching.windows)} windows can be used"
        words = "too few to judge signs and mounting; look at rates, lost samples and channels"
        return [*lines, f"WRONG: {used}: {words}"], False
    verdict = explain_residuals(config, problem, watching.made, progress)
    told = list(dict.fromkeys([*verdict.found, *filter(None, [verdict.mounting])]))
    mounted = any(text.startswith("imu") for text in told)
    judged = config.imu.present and not (mounted or jumps)  # the gyro checks the tracker
    turned = tracker_findings(config, watching.windows) if judged else []
    lines += [f"WRONG: {text}" for text in [*turned, *told]]
    lines += [f"doubtful: {text}" for text in filter(None, [verdict.doubtful])]
    lines.append(_residual_words(verdict, config))
    return lines, not (wrong or turned or told or verdict.before > LARGE)


def _advice(source: str, status: Mapping[str, Any]) -> str:
    """Return what the user should look at, unless it is known what the device does not send."""
    counts = status["samples"][source]
    if source in status["lacks"] or counts["accepted"]:
        return ""
    if source not in (IMU, STAR_TRACKER):
        return "; compare node numbers and format of joints[] with the nodes"
    if not counts["received_bytes"]:
        return "; was it switched on, and its port right?"
    return f"; compare {source}.baud_rate and {source}.driver with the device"


def _residual_words(verdict: Verdict, config: Config) -> str:
    level = f"residuals {verdict.before**0.5:.3g} times the declared noise"
    after = f"{verdict.after**0.5:.3g} times"
    if verdict.before <= LARGE:
        fits = "signs, order of joints" if verdict.mounting else ALL_FITS
        return f"{fits}: fit ({level})"
    if verdict.found:
        return f"{level}, {after} with these changes"
    lever = "the lever arm imu.mounting.p_BS_m, " if config.imu.present else ""
    near = f" (nearest, {after}: {'; '.join(verdict.nearest)})" if verdict.nearest else ""
    return (
        f"WRONG: {level}, and none of {verdict.tried} usual mistakes explains them{near}; is it a "
        "recording of this robot and base? Look at the masses of the links (kg), the priors of "
        f"bodies, zero offsets, {lever}delays, the tool frame"
    )
