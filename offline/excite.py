"""The command `fsw excite`: plan a trajectory, or judge an existing trajectory or recording."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fsw.config import Config
from fsw.errors import ConfigError
from fsw.estimators.effects.registered import ON_BASE
from fsw.exchange.sinks import Message, NullSink
from fsw.messages import Block, FloatArray
from offline.out_argument import refuse_existing
from offline.progress import Progress
from offline.replay import replay
from planner import assess, criteria, foreseen, spline
from planner.collision import Collisions
from planner.firings import Firing
from planner.limits import MotionLimits
from planner.motion import bounds, judged, knowledge, loaded, planned
from planner.plan import DENSER
from planner.request import InfeasibleError, MotionRequest
from planner.subject import Subject, build_subject
from planner.verify import Use, every_limit

FAILED, DONE = 1, 0
WORDS = {  # meaning of each criterion; see docs/excitation.md
    "sigma": "geometric mean of the predicted sigmas",
    "d": "root of the determinant of their covariance in prior sigmas",
    "a": "root of its trace",
    "e": "root of its largest eigenvalue",
    "cond": "condition number of the torque regressor",
    "gamma": "xi1 cond + xi2 / integral of |torque|",
}
ENDINGS = (".yaml", ".yml")
MOST = {  # upper limits of arguments: larger values need too much memory or time
    "duration_s": 3600.0,
    "rate_hz": 1000.0,
    "export_rate_hz": 10_000.0,
    "starts": 1000,
    "draws": 1000,
}


def excite(arguments: argparse.Namespace, config: Config) -> int:
    """Run the command and return its exit code: FAILED if limits are broken, otherwise DONE.

    Raises
    ------
    ConfigError if the request is wrong.
    """
    if arguments.unknown is not None:
        both = ("base", "target")
        config = config.with_unknown(both if arguments.unknown == "both" else (arguments.unknown,))
    _check_numbers(arguments)
    weights = dict(_weight(text) for text in arguments.weight)
    subject = build_subject(
        config,
        after=arguments.after,
        weights=weights,
        spread=arguments.spread,
        draws=arguments.draws,
        seed=arguments.seed,
    )
    if arguments.evaluate is not None and arguments.evaluate.suffix not in ENDINGS:
        return _recorded(arguments.evaluate, config, subject)
    if arguments.limits is None:
        raise ConfigError("--limits: missing; which limits hold is never assumed")
    limits, collisions = bounds(config, subject, arguments.limits, _tell)
    for line in what_stands_still(config, limits.firings):
        _tell(line)
    if arguments.evaluate is not None:
        return _evaluate(arguments, subject, limits, collisions)
    return _plan(arguments, subject, limits, collisions)


def what_stands_still(config: Config, firings: Sequence[Firing]) -> list[str]:
    """Return a line for each kind of actuator whose motion the plan leaves out."""
    own = [kind for kind in ON_BASE if getattr(config, kind.section)]
    return [words for kind in own if (words := kind.unplanned(bool(firings)))]


def _check_numbers(arguments: argparse.Namespace) -> None:
    for key in (
        "duration_s",
        "knot_s",
        "rate_hz",
        "export_rate_hz",
        "starts",
        "jobs",
        "iterations",
    ):
        value = getattr(arguments, key)
        if not (np.isfinite(value) and value > 0):
            raise ConfigError(f"--{key.replace('_', '-')}: {value} must be positive")
    for key, most in MOST.items():
        if getattr(arguments, key) > most:
            flag = f"--{key.replace('_', '-')}"
            raise ConfigError(f"{flag}: {getattr(arguments, key):g} must be at most {most:g}")
    for key in ("spread", "draws", "seed", "xi1", "xi2"):
        value = getattr(arguments, key)
        if not (np.isfinite(value) and value >= 0):
            raise ConfigError(f"--{key}: {value} must not be negative")
    if arguments.evaluate is None:
        if arguments.out is None:
            raise ConfigError("--out: missing; where shall the trajectory go? (or --evaluate FILE)")
        refuse_existing(arguments)


def _weight(text: str) -> tuple[str, float]:
    name, separator, value = text.partition("=")
    try:
        return name, float(value)
    except ValueError as error:
        raise ConfigError(f"--weight {text!r}: must be NAME=NUMBER{separator and ''}") from error


def _plan(
    arguments: argparse.Namespace,
    subject: Subject,
    limits: MotionLimits,
    collisions: Collisions | None,
) -> int:
    request = MotionRequest(
        criterion=arguments.criterion,
        gamma=_gamma(arguments),
        duration_s=arguments.duration_s,
        knot_s=arguments.knot_s,
        closed=arguments.closed,
        starts=arguments.starts,
        jobs=arguments.jobs,
        iterations=arguments.iterations,
        rate_hz=arguments.rate_hz,
        seed=arguments.seed,
    )
    guess = None if arguments.start_from is None else spline.load(arguments.start_from)
    out = arguments.out
    try:
        with Progress("excite") as progress:
            motion = planned(subject, limits, collisions, request, progress, guess)
            motion.save(out, arguments.export_rate_hz)
            progress("drawing")
            _picture(subject, limits, collisions, motion.trajectory, out.with_suffix(".png"))
    except InfeasibleError as error:
        _tell(f"infeasible: {error}")
        return FAILED
    sys.stdout.write("".join(f"{line}\n" for line in motion.starts))
    sys.stdout.write(_text(subject, motion.root, motion.values, motion.uses))
    sys.stdout.write(f"\nwritten: {out}\n")
    return DONE


def _evaluate(
    arguments: argparse.Namespace,
    subject: Subject,
    limits: MotionLimits,
    collisions: Collisions | None,
) -> int:
    trajectory = loaded(arguments.evaluate, subject.config)
    rate_hz = arguments.rate_hz
    members = [subject.x, *subject.draws]
    uses = every_limit(subject, limits, collisions, trajectory, DENSER * rate_hz, members)
    values, root = judged(subject, trajectory, rate_hz, _gamma(arguments))
    sys.stdout.write(_text(subject, root, values, uses) + "\n")
    if arguments.out is not None:
        _picture(subject, limits, collisions, trajectory, arguments.out.with_suffix(".png"))
    return DONE if uses[0].excess <= 0 else FAILED


class _Blocks(NullSink):
    """Keeps the blocks of a replay in a list."""

    def __init__(self) -> None:
        self.blocks: list[Block] = []

    def put(self, message: Message) -> None:
        """Keep a block; discard every other message."""
        if isinstance(message, Block):
            self.blocks.append(message)


def _recorded(recording: Path, config: Config, subject: Subject) -> int:
    """Judge the motion of a recording from its blocks, without a planned trajectory."""
    sink = _Blocks()
    with Progress("excite") as progress:
        replay(recording, config, sink=sink, progress=progress)
    root = foreseen.block_root(subject, sink.blocks)
    values = assess.fused_criteria(subject, root)
    sys.stdout.write(_text(subject, root, values, []) + f"\n{len(sink.blocks)} windows\n")
    return DONE


def _text(subject: Subject, root: FloatArray, values: dict[str, float], uses: list[Use]) -> str:
    lines = [f"{name}: {value:.6g} ({WORDS[name]})" for name, value in values.items()]
    lines += knowledge(subject, root)
    lines += [("BROKEN " if use.excess > 0 else "kept ") + use.text() for use in uses]
    return "\n".join(lines)


def _picture(
    subject: Subject,
    limits: MotionLimits,
    collisions: Collisions | None,
    trajectory: spline.Trajectory,
    path: Path,
) -> None:
    from planner.picture import draw

    draw(subject, limits, collisions, trajectory, path)


def _gamma(arguments: argparse.Namespace) -> criteria.Gamma:
    return criteria.Gamma(xi1=arguments.xi1, xi2=arguments.xi2)


def _tell(text: str) -> None:
    sys.stderr.write(f"fsw: excite: {text}\n")
    sys.stderr.flush()
