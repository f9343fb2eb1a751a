"""Python API: functions that notebooks, scripts and the command line share; see docs/api.md.

All values are in SI units. Inertia is xx xy xz yy yz zz about the centre of mass, in the axes of
the body: B for the base, E for a target. Wrong input raises ConfigError with one line per fault.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import cached_property
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from fsw.checks.configuration import validate
from fsw.errors import ConfigError
from fsw.exchange.recording_parts import contents_of, parts_of
from fsw.messages import FloatArray
from fsw.service.recorder import recorded_config
from offline.arrays import Samples
from offline.calls import T, errors_in_calls, in_calls
from offline.check_recording import check_recording, verdict_line
from offline.export_body import FORMATS
from offline.identified_body import Body, body_of
from offline.identify import Evidence, to_text
from offline.identify import identify as identify_recording
from offline.replay import replay as replay_recording
from offline.replay_result import ReplayResult
from offline.report import Written, write_report
from offline.report.identified import write_identified
from offline.report.live import LIVE, in_the_background, recording_of, status_of
from offline.robot import Criterion, Folder, Method, Robot, Weighting, named, one_of
from offline.span import Span
from offline.threads import on_one_thread

if TYPE_CHECKING:
    from planner.motion import PlannedMotion


class Recording:
    """A recording with its later parts; messages stay on disk until a function reads them.

    `notes` say how the arrays were read from which it was made; empty: it is not from arrays.
    """

    def __init__(
        self, path: Path | str, folder: Folder | None = None, notes: Sequence[str] = ()
    ) -> None:
        self.path, self._folder, self.notes = Path(path), folder, tuple(notes)
        self.parts: Sequence[Path] = parts_of(self.path)
        held = contents_of(self.parts)
        self.channels: tuple[str, ...] = held.topics
        self.truncated: bool = held.truncated
        self.metadata: Mapping[str, Mapping[str, str]] = held.metadata

    @cached_property
    def robot(self) -> Robot:
        """The robot that the configuration inside the recording describes.

        Raises
        ------
        ConfigError when the recording contains no configuration or no robot model.
        """
        folder = Folder()
        return Robot(recorded_config(self.path, folder.path), folder=folder)

    def texts(self, value: T) -> T:
        """Return texts of a result; if it is from arrays, with Python calls for commands."""
        return in_calls(value, self.path) if self.notes else value

    def named(self) -> AbstractContextManager[None]:
        """Return a context in which errors have their text as `texts` returns it."""
        return errors_in_calls(self.path) if self.notes else nullcontext()

    def __repr__(self) -> str:
        return f"Recording({self.path}: {', '.join(self.channels)})"


Source = Recording | Samples | Path | str


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Identification:
    """Result of a batch method; docs/output.md describes every field of `values`."""

    values: Mapping[str, Any]

    @property
    def status(self) -> str:
        """OK, or the reason why the estimate must not be used."""
        return str(self.values["status"])

    @property
    def valid(self) -> bool:
        """Whether the estimate may be used."""
        return self.status == "OK"

    @property
    def passed(self) -> bool | None:
        """Whether predictions of held-out windows met their bounds; None: no window held out."""
        holdout = self.values.get("holdout")
        return None if holdout is None else bool(holdout["passed"])

    @property
    def names(self) -> tuple[str, ...]:
        """Names (p,) of the published states: 10 per unknown body, then biases and others."""
        return tuple(self.values["names"])

    @property
    def mean(self) -> FloatArray:
        """Estimated states (p,) in SI units, in the order of `names`."""
        return np.array(self.values["mean"], np.float64)

    @property
    def covariance(self) -> FloatArray:
        """Covariance (p, p) of `mean`."""
        return np.array(self.values["covariance"], np.float64)

    @property
    def bodies(self) -> dict[str, Body]:
        """Identified bodies by name; each is the physically consistent body nearest to `mean`."""
        return {name: body_of(self.values, name) for name in self.values["estimate"]}

    def export(self, kind: str, body: str | None = None) -> str:
        """Return a body as text; `kind` is urdf, sdf, mjcf, json, csv or ros2.

        Raises
        ------
        ConfigError for an unknown kind or body, or if `body` is None and there are several bodies.
        """
        one_of("kind", kind, tuple(FORMATS))
        return FORMATS[kind](body_of(self.values, body))

    def __str__(self) -> str:
        text = to_text(self.values)
        return in_calls(text) if self.values.get("input") else text

    __repr__ = __str__


@dataclass(frozen=True, slots=True, repr=False)
class Findings:
    """What `check` found, printed as `fsw check CONFIG RECORDING` prints it."""

    lines: tuple[str, ...]  # one for each finding; WRONG: of a mistake
    agree: bool  # whether the data fit the robot
    verdict: str

    def __str__(self) -> str:
        return "\n".join([*self.lines, self.verdict])

    __repr__ = __str__


def load(path: Path | str) -> Recording:
    """Open a recording (MCAP) and the parts that continue it.

    Raises
    ------
    ConfigError when a file cannot be read or is not an MCAP file.
    """
    return Recording(path)


@on_one_thread
def check(
    recording: Source,
    robot: Robot | None = None,
    *,
    from_s: float = 0.0,
    to_s: float = inf,
    progress: Callable[[str], None] = lambda _text: None,
) -> Findings:
    """Compare a robot with its data; name the usual mistakes: signs, units, order, mounting.

    Parameters
    ----------
    robot : robot of the recording; None: the configuration inside the recording
    from_s, to_s : the part of the recording to use [s from its start]
    progress : called with a line of text at every step

    Raises
    ------
    ConfigError if recording and configuration do not fit.
    """
    held, robot = _pair(recording, robot)
    with held.named():
        problem, _ = validate(robot.config)
        lines, agree = check_recording(
            held.path, robot.config, problem, progress, Span(from_s, to_s)
        )
    verdict = held.texts(verdict_line(held.path, robot.config, agree))
    return Findings(tuple(held.texts(lines)), agree, verdict)


@on_one_thread
def identify(
    recording: Source,
    robot: Robot | None = None,
    *,
    method: Method = "fused",
    unknown: str | None = None,
    weighting: Weighting | None = None,
    from_s: float = 0.0,
    to_s: float = inf,
    holdout: float | None = None,
    reference: Source | None = None,
    report: Path | str | None = None,
    progress: Callable[[float, str], bool] | None = None,
) -> Identification:
    """Identify bodies from a recording or arrays by one batch method.

    Parameters
    ----------
    recording : a recording, or `Samples`, from which one is made in a temporary folder
    robot : robot of the recording; None: the configuration inside the recording
    unknown : base, target, both, or names with commas; None: as the configuration says
    weighting : for method mrnea only; None: as the configuration says
    from_s, to_s : the part of the recording to use [s from its start]
    holdout : share of the windows (up to 0.9) to hold out and predict; None: all windows are used
    reference : recording of the robot with all unknown bodies but the base removed; None: not used
    report : path of an HTML page; CSV and PNG files go beside it; None: no page is written
    progress : called with the share done (0 to 1) and a line of text; returning False ends the run

    Raises
    ------
    ConfigError if recording, configuration or choices do not fit; EstimatorError if no window can
    be used.
    """
    held, robot = _pair(recording, robot)
    with held.named():
        chosen = robot.with_choices(method=method, weighting=weighting, unknown=unknown)
        span = Span(from_s, to_s)
    _apart(report, held)
    empty = None if reference is None else _pair(reference, robot)[0].path

    def show(values: Mapping[str, Any], evidence: Evidence) -> None:
        if report is not None:
            write_identified(values, evidence, held.path, chosen.config, span, Path(report))

    shown = None if report is None else show
    with held.named():
        values = identify_recording(
            held.path, chosen.config, method, (), progress, span, holdout, empty, shown
        )
    noted = {"input": list(held.notes)} if held.notes else {}
    return Identification(held.texts(values) | noted)


@on_one_thread
def replay(
    recording: Source,
    robot: Robot | None = None,
    *,
    from_s: float = 0.0,
    to_s: float = inf,
    progress: Callable[[str], None] = lambda _text: None,
) -> ReplayResult:
    """Run the daemon's recursive estimator on a recording.

    Parameters
    ----------
    robot : robot of the recording; None: the configuration inside the recording
    from_s, to_s : the part of the recording to use [s from its start]
    progress : called with a line of text every ten seconds of the recording

    Raises
    ------
    ConfigError if recording and configuration do not fit.
    """
    held, robot = _pair(recording, robot)
    with held.named():
        own = replay_recording(held.path, robot.config, span=Span(from_s, to_s), progress=progress)
    return held.texts(own)


@on_one_thread
def report(
    recording: Source,
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
    """Replay a recording and write the report `out`, one HTML page that needs no other file.

    Parameters
    ----------
    recording : a recording; "live": the recording that the running daemon of `robot` is writing
    robot : robot of the recording; None: the configuration inside the recording
    with_csv, with_png, with_parquet : also write tables and a picture, named after the page
    with_mcap : also write the estimate over time, with layouts for Foxglove and PlotJuggler
    from_s, to_s : the part of the recording to use [s from its start]

    Raises
    ------
    ConfigError if recording and configuration do not fit, or a file cannot be written; PortError
    if the recording is "live" and no daemon answers.
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
    with held.named():
        written = write_report(
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
    return held.texts(written)


@on_one_thread
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
    """Plan a motion that identifies the unknown bodies well and keeps the limits of a YAML file.

    Parameters
    ----------
    knot_s : time between two knots of the spline
    criterion : sigma, d, a, e, cond or gamma; see docs/excitation.md
    iterations : iterations of the solver in each of the `starts`

    Raises
    ------
    ConfigError for a wrong request; InfeasibleError when no motion keeps the limits; ImportError
    if the extra `excite` is not installed.
    """
    from planner.motion import bounds, planned
    from planner.request import MotionRequest
    from planner.subject import build_subject

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


def _pair(recording: Source, robot: Robot | None) -> tuple[Recording, Robot]:
    if robot is not None and not isinstance(robot, Robot):
        raise ConfigError(f"robot: {named(robot)} must be a Robot, such as Robot('robot.yaml')")
    if not isinstance(recording, Recording | Samples | Path | str):
        raise ConfigError(f"recording: {named(recording)} must be a path or Samples(t_s=, q=)")
    if not isinstance(recording, Samples):
        held = recording if isinstance(recording, Recording) else load(recording)
        return held, held.robot if robot is None else robot
    if robot is None:
        raise ConfigError("robot: missing; arrays have none: Robot.from_urdf('arm.urdf', tool=...)")
    robot, folder = robot.fitted(recording), Folder()
    path = folder.path / "samples"
    notes = recording.write(robot.config, path)
    return Recording(path, folder, notes), robot


def _apart(out: Path | str | None, held: Recording) -> None:
    """Raise ConfigError if the page `out` would overwrite a file of its recording."""
    if out is not None and Path(out).exists() and any(part.samefile(out) for part in held.parts):
        raise ConfigError(f"{out}: is the recording; choose another name")
