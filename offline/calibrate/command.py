"""The command `fsw calibrate`: replay recordings, compute figures, print and write them."""

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from fsw.config import Config
from fsw.config.overlay_file import with_overlays
from fsw.errors import NUMERICAL, ConfigError, EstimatorError, unforeseen
from fsw.estimators.model.building import build_problem, joint_order
from fsw.estimators.model.problem import Problem
from fsw.estimators.model.robot import RobotModel
from fsw.estimators.pipeline import Pipeline
from fsw.estimators.recursive.online import build_online
from offline.calibrate.figures import overlay_text, overlay_values, table, to_json
from offline.calibrate.motion import motion_figures
from offline.calibrate.rest import rest_figures
from offline.replay import replay
from offline.robot import Robot
from offline.span import Span
from offline.watching import Watching

Tell = Callable[[str], None]


def calibrate(arguments: argparse.Namespace, tell: Tell) -> tuple[str, bool]:
    """Calibrate from recordings; return the text to print, and whether the overlay has a value.

    Raises
    ------
    ConfigError if recording, configuration or choices do not fit, or the file cannot be written;
    EstimatorError if data are too few, the robot moves (rest), or the fit fails (motion).
    """
    recordings: Sequence[Path] = arguments.recording
    for path in (arguments.config, *recordings, *arguments.overlay):
        if arguments.out is not None and path.resolve() == arguments.out.resolve():
            raise ConfigError(f"--out {arguments.out}: is read by this command; must be another")
    robot = Robot(arguments.config).with_overlays(*arguments.overlay)
    config = robot.config.with_sections(wrench_sensors=())  # it calibrates joints and base
    span = Span(arguments.from_s, arguments.to_s)
    for warning in robot.warnings:
        tell(f"warning: {config.name}: {warning}")
    if len(recordings) > 1 and (arguments.mode == "rest" or config.joints):
        raise ConfigError(
            f"{recordings[1]}: several recordings make one calibration only of a body without "
            "joints, in motion"
        )
    model = RobotModel(config.resolve(config.robot.urdf), config.robot.tool_frame)
    problem = build_problem(config, model)

    def read(stamped: Config) -> Watching:
        return _replayed(recordings, stamped, problem, span, tell)

    def progress(_ratio: float, text: str) -> bool:
        tell(text)
        return True

    try:
        if arguments.mode == "rest":
            seen = read(config)
            figures = rest_figures(config, problem, seen.windows, seen.made)
        else:
            figures = motion_figures(config, read, progress)
    except (ConfigError, EstimatorError):
        raise
    except NUMERICAL as error:
        raise EstimatorError(f"no figures: arithmetic fails ({unforeseen(error)})") from error
    values = overlay_values(config, figures)
    lines = table(figures)
    recorded = datetime.fromtimestamp(recordings[-1].stat().st_mtime, UTC)
    comments = [
        f"fsw calibrate {arguments.mode} {' '.join(map(str, recordings))}{span.words()}",
        f"recorded until {recorded:%Y-%m-%d %H:%M:%S} UTC; configuration {config.name}",
        "changes of what is configured, 1 sigma:",
        *lines,
    ]
    if arguments.out is not None and values:
        _write(arguments.out, overlay_text(values, comments), config)
    if arguments.json:
        return json.dumps({"figures": to_json(figures), "overlay": values}), bool(values)
    return "\n".join(lines), bool(values)


def _replayed(
    recordings: Sequence[Path], config: Config, problem: Problem, span: Span, tell: Tell
) -> Watching:
    """Return the windows and blocks of all recordings in order; no estimator runs."""
    every = Watching(config, joint_order(config, problem.model), alone=True)
    for recording in recordings:
        tell(f"reading {recording}")
        seen = Watching(config, joint_order(config, problem.model), alone=True)
        pipeline = Pipeline(conditioner=seen, estimator=build_online(config, problem.model))
        result = replay(recording, config, pipeline=pipeline, span=span, progress=tell)
        if result.truncated:
            tell(f"warning: {result.cut_off()}")
        first = 1 + every.made[-1].index if every.made else 0
        every.windows += seen.windows
        every.made += [replace(own, index=first + own.index) for own in seen.made]
    return every


def _write(path: Path, text: str, config: Config) -> None:
    """Write an overlay; write nothing and raise ConfigError if `config` does not accept it."""
    aside = path.with_name(f"{path.name}.tmp")
    try:
        aside.write_text(text, encoding="utf-8")
        Robot(with_overlays(config, [aside]))
        aside.replace(path)
    except OSError as error:
        raise ConfigError(f"--out {path}: cannot be written: {error.strerror}") from error
    finally:
        aside.unlink(missing_ok=True)
