"""The functions that notebooks, scripts and the command line share; docs/api.md shows them.

SI units; inertia is xx xy xz yy yz zz about the centre of mass, in the body's axes: B of the base,
the tool frame of a target. Everything raises `fsw.messages.errors.ConfigError`, one line per fault.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from fsw.commands.export_body import FORMATS
from fsw.commands.identified_body import Body, body_of
from fsw.commands.identify import Evidence, to_text
from fsw.commands.identify import identify as identify_recording
from fsw.commands.replay import replay as replay_recording
from fsw.commands.replay_result import ReplayResult
from fsw.commands.report import Written, write_report
from fsw.commands.report.identified import write_identified
from fsw.commands.report.live import LIVE, in_the_background, recording_of, status_of
from fsw.commands.robot import Criterion, Folder, Method, Robot, Weighting, one_of
from fsw.commands.span import Span
from fsw.exchange.recording_parts import contents_of, parts_of
from fsw.messages import FloatArray
from fsw.messages.errors import ConfigError
from fsw.service.recorder import recorded_config

if TYPE_CHECKING:
    from fsw.excitation.motion import PlannedMotion


class Recording:
    """A recording and the parts that follow it; nothing of its messages is in memory."""

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.parts: Sequence[Path] = parts_of(self.path)
        held = contents_of(self.parts)
        self.channels: tuple[str, ...] = held.topics
        self.truncated: bool = held.truncated
        self.metadata: Mapping[str, Mapping[str, str]] = held.metadata

    @cached_property
    def robot(self) -> Robot:
        """The robot of the configuration within the recording.

        Raises
        ------
        ConfigError when the recording carries none.
        """
        folder = Folder()
        return Robot(recorded_config(self.path, folder.path), folder=folder)

    def __repr__(self) -> str:
        return f"Recording({self.path}: {', '.join(self.channels)})"


@dataclass(frozen=True, slots=True, eq=False)
class Identification:
    """Result of a method; `values` holds every field, docs/output.md describes each."""

    values: Mapping[str, Any]

    @property
    def status(self) -> str:
        """OK, or why the estimate must not be used."""
        return str(self.values["status"])

    @property
    def valid(self) -> bool:
        """Whether the estimate may be used."""
        return self.status == "OK"

    @property
    def passed(self) -> bool | None:
        """Whether held-out windows were predicted within their bounds; None: none were held out."""
        holdout = self.values.get("holdout")
        return None if holdout is None else bool(holdout["passed"])

    @property
    def names(self) -> tuple[str, ...]:
        """Names (p,) of the states: 10 moments per body, then errors of sensors."""
        return tuple(self.values["names"])

    @property
    def mean(self) -> FloatArray:
        """State (p,)."""
        return np.array(self.values["mean"], np.float64)

    @property
    def covariance(self) -> FloatArray:
        """Covariance (p, p) of the state."""
        return np.array(self.values["covariance"], np.float64)

    @property
    def bodies(self) -> dict[str, Body]:
        """Identified bodies by name, each the nearest physically consistent one."""
        return {name: body_of(self.values, name) for name in self.values["estimate"]}

    def export(self, kind: str, body: str | None = None) -> str:
        """Return a body as `urdf`, `sdf`, `mjcf`, `json`, `csv` or `ros2`; `body` of several.

        Raises
        ------
        ConfigError for a kind or a body that is not there.
        """
        one_of("kind", kind, tuple(FORMATS))
        return FORMATS[kind](body_of(self.values, body))

    def __str__(self) -> str:
        return to_text(self.values)


def load(path: Path | str) -> Recording:
    """Open a recording (MCAP), with the parts that follow it.

    Raises
    ------
    ConfigError when a file cannot be read or is no MCAP file.
    """
    return Recording(path)


def identify(
    recording: Recording | Path | str,
    robot: Robot | None = None,
    *,
    method: Method = "fused",
    unknown: str | None = None,
    weighting: Weighting | None = None,
    from_s: float = 0.0,
    to_s: float = inf,
    holdout: float | None = None,
    reference: Recording | Path | str | None = None,
    report: Path | str | None = None,
    progress: Callable[[float, str], bool] | None = None,
) -> Identification:
    """Identify bodies from a recording by one batch method.

    Parameters
    ----------
    robot : None: the configuration within the recording
    unknown : base, target, both, or names with commas; None: as the configuration says
    weighting : of mrnea alone; None: as the configuration says
    from_s, to_s : the part of the recording [s from its start]
    holdout : share of the windows that is predicted and not used; None: all are used
    reference : recording of the robot without the unknown bodies, but for the base; None: no
        reference
    report : one HTML page of the result, with CSV and PNG beside it; None: none is written
    progress : called with the share done and a line of text; False ends the run

    Raises
    ------
    ConfigError if recording, configuration or choices do not fit; EstimatorError without data.
    """
    held, robot = _pair(recording, robot)
    chosen = robot.with_choices(method=method, weighting=weighting, unknown=unknown)
    _apart(report, held)
    span = Span(from_s, to_s)
    empty = None if reference is None else _pair(reference, robot)[0].path

    def show(values: Mapping[str, Any], evidence: Evidence) -> None:
        if report is not None:
            write_identified(values, evidence, held.path, chosen.config, span, Path(report))

    shown = None if report is None else show
    values = identify_recording(
        held.path, chosen.config, method, (), progress, span, holdout, empty, shown
    )
    return Identification(values)


def replay(
    recording: Recording | Path | str,
    robot: Robot | None = None,
    *,
    from_s: float = 0.0,
    to_s: float = inf,
    progress: Callable[[str], None] = lambda _text: None,
) -> ReplayResult:
    """Run the flight's own recursive estimator on a recording.

    Parameters
    ----------
    robot : None: the configuration within the recording
    from_s, to_s : the part of the recording [s from its start]
    progress : called with a line of text every ten seconds of the recording

    Raises
    ------
    ConfigError if recording and configuration do not fit.
    """
    held, robot = _pair(recording, robot)
    span = Span(from_s, to_s)
    return replay_recording(held.path, robot.config, span=span, progress=progress)


def report(
    recording: Recording | Path | str,
    robot: Robot | None = None,
    out: Path | str = "report.html",
    *,
    with_csv: bool = False,
    with_png: bool = False,
    with_parquet: bool = False,
    with_mcap: bool = False,
    from_s: float = 0.0,
    to_s: float = inf,
    progress: Callable[[str], None] = lambda _text: None,
) -> Written:
    """Replay a recording and write one HTML page of it that needs nothing but itself.

    Parameters
    ----------
    recording : or "live", what the running daemon of `robot` has recorded so far
    robot : None: the configuration within the recording
    with_csv, with_png, with_parquet : tables and a picture beside the page, by its name
    with_mcap : the estimate over time for Foxglove and PlotJuggler, with a layout for each
    from_s, to_s : the part of the recording [s from its start]

    Raises
    ------
    ConfigError if recording and configuration do not fit, or nothing can be written; PortError
    without a running daemon.
    """
    daemon = None
    if str(recording) == LIVE:
        if robot is None:
            raise ConfigError("--config: a report of a running daemon needs its configuration")
        daemon = status_of(robot.config)
        recording = recording_of(daemon)
        in_the_background()
    held, robot = _pair(recording, robot)
    _apart(out, held)
    return write_report(
        held.path,
        robot.config,
        Path(out),
        span=Span(from_s, to_s),
        with_csv=with_csv,
        with_png=with_png,
        with_parquet=with_parquet,
        with_mcap=with_mcap,
        daemon=daemon,
        progress=progress,
    )


def plan(
    robot: Robot,
    limits: Path | str,
    *,
    unknown: str | None = None,
    duration_s: float = 60.0,
    knot_s: float = 2.5,
    criterion: Criterion = "sigma",
    iterations: int = 40,
    starts: int = 1,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _text: None,
) -> PlannedMotion:
    """Plan a motion inside the limits of a YAML file that identifies the unknown bodies well.

    Parameters
    ----------
    knot_s : distance of the spline's knots
    criterion : sigma, d, a, e, cond or gamma: docs/excitation.md
    iterations : of the solver, for each of the `starts`

    Raises
    ------
    ConfigError for a wrong request; InfeasibleError when no motion keeps the limits; ImportError
    without the extra `excite`.
    """
    from fsw.excitation.motion import bounds, planned
    from fsw.excitation.request import MotionRequest
    from fsw.excitation.subject import build_subject

    one_of("criterion", criterion, get_args(Criterion))
    request = MotionRequest(
        criterion=criterion,
        duration_s=duration_s,
        knot_s=knot_s,
        iterations=iterations,
        starts=starts,
        seed=seed,
    )
    config = robot.with_choices(unknown=unknown).config
    subject = build_subject(config, seed=request.seed)
    motion_limits, collisions = bounds(config, subject, Path(limits), progress)
    return planned(subject, motion_limits, collisions, request, progress)


def _pair(recording: Recording | Path | str, robot: Robot | None) -> tuple[Recording, Robot]:
    if robot is not None and not isinstance(robot, Robot):
        raise ConfigError(f"robot: {robot!r} must be a Robot, such as Robot('robot.yaml')")
    held = recording if isinstance(recording, Recording) else load(recording)
    return held, held.robot if robot is None else robot


def _apart(out: Path | str | None, held: Recording) -> None:
    """Raise ConfigError where a page would overwrite the recording it is made of."""
    if out is not None and Path(out).exists() and any(part.samefile(out) for part in held.parts):
        raise ConfigError(f"{out}: is the recording; choose another name")
