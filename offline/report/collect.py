"""Collect the data of a report in one replay."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from fsw.config import Config
from fsw.errors import WRONG_CONTENT, ConfigError, brief
from fsw.estimators.block_view import fitting
from fsw.estimators.conditioning.plausible import plausible
from fsw.estimators.model.inertia import report_jacobian
from fsw.estimators.model.problem import IndexArray, Problem
from fsw.estimators.model.state_groups import group_of
from fsw.estimators.pipeline import default_pipeline
from fsw.estimators.recursive.online import OnlineEstimator
from fsw.exchange.recording import messages_of
from fsw.exchange.recording_parts import contents_of, parts_of
from fsw.exchange.sinks import Message, NullSink
from fsw.messages import Block, Estimate, Event, FloatArray
from offline.replay import replay
from offline.replay_result import ReplayResult
from offline.residuals import ChannelResiduals, channel_residuals
from offline.shelf import Shelf
from offline.span import WHOLE, Span

PACKAGES = ("inertia-daemon", "numpy", "scipy", "pin", "mcap", "pydantic")
# keys of a status record that a report shows; whole records of a long run fill the memory
TIMING = ("t_ns", "ticks", "slips", "max_late_us", "work_us", "tasks_us")
STATUS, EVENTS = "/tm", "/events"
T = TypeVar("T")
Progress = Callable[[str], None]
State = tuple[Problem, FloatArray, FloatArray]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Collected:
    """Data of a report on a replayed recording; times are stamps of the recording [ns]."""

    config: Config
    result: ReplayResult
    estimates: Sequence[Estimate]
    blocks: Sequence[Block]
    residuals: ChannelResiduals | None  # None: no state to predict from
    shares: Mapping[str, Mapping[str, float]]  # per quantity: share of sigma squared by cause
    events: Sequence[Event]  # of the recorded run; of the replay if only a part was replayed
    versions: Mapping[str, str]
    name: str = ""  # of the recording
    span: Span = WHOLE
    flown: Sequence[Mapping[str, Any]] = ()  # status records of the recorded run
    metadata: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    daemon: Mapping[str, Any] | None = None  # status of a running daemon; None: no live report


class Collector(NullSink):
    """A sink that keeps the blocks and estimates of a replay."""

    def __init__(self) -> None:
        self.blocks: Shelf[Block] = Shelf()
        self.estimates: Shelf[Estimate] = Shelf()

    def put(self, message: Message) -> None:
        """Keep a block or an estimate; discard every other message."""
        if isinstance(message, Block):
            self.blocks.append(message)
        elif isinstance(message, Estimate):
            self.estimates.append(message)


def collect(
    recording: Path,
    config: Config,
    span: Span = WHOLE,
    daemon: Mapping[str, Any] | None = None,
    progress: Progress = lambda _text: None,
) -> Collected:
    """Replay a recording and return the data of its report.

    `daemon` is the status of the running daemon for a live report; None: no live report.

    Raises
    ------
    ConfigError when recording and configuration do not fit.
    """
    sink, pipeline = Collector(), default_pipeline(config)
    result = replay(recording, config, sink=sink, pipeline=pipeline, span=span, progress=progress)
    progress("residuals and what limits the accuracy")
    blocks = fitting(sink.blocks, map(plausible, sink.blocks))
    state = state_of(pipeline.estimator) if blocks and result.estimate is not None else None
    found = collected_at(recording, span, config, result, blocks, state)
    return replace(found, estimates=sink.estimates, daemon=daemon)


def state_of(estimator: object) -> State | None:
    """Return problem, mean (p,) and covariance (p, p) of an estimator's whole state.

    An `Estimate` contains only the published states. None: the estimator is no `OnlineEstimator`.
    """
    if not isinstance(estimator, OnlineEstimator):
        return None
    return estimator.problem, estimator.recursion.x, estimator.recursion.covariance()


def collected_at(
    recording: Path,
    span: Span,
    config: Config,
    result: ReplayResult,
    blocks: Sequence[Block],
    state: State | None,
) -> Collected:
    """Return the data of a report on a recording, with the last estimate only.

    Parameters
    ----------
    state : problem, mean (p,) and covariance (p, p) of the whole state; None: no residuals
    """
    parts = parts_of(recording)
    held = contents_of(parts)
    found = collected_of(config, result, blocks, state)
    events = found.events
    if EVENTS in held.topics and span == WHOLE:
        events = list(_parsed(parts, EVENTS, lambda values: Event(**values)))
    return replace(
        found,
        name=recording.name,
        span=span,
        events=events,
        flown=list(_parsed(parts, STATUS, _timing)) if STATUS in held.topics else [],
        metadata=held.metadata,
    )


def _parsed(parts: Sequence[Path], topic: str, parse: Callable[[dict[str, Any]], T]) -> Iterator[T]:
    """Yield the messages of a topic. Raises ConfigError if one is not what the recorder writes."""
    for message in messages_of(parts, [topic]):
        try:
            yield parse(json.loads(message.data))
        except WRONG_CONTENT as error:
            words = f"{topic} at {message.t_ns} ns is not of this software: {brief(error)}"
            raise ConfigError(f"{words}; the recording is damaged") from error


def _timing(values: dict[str, Any]) -> dict[str, Any]:
    """Return what a report shows of a status record."""
    return {key: values[key] for key in TIMING if key in values}


def collected_of(
    config: Config, result: ReplayResult, blocks: Sequence[Block], state: State | None
) -> Collected:
    """Return the data of a report that a result and its blocks supply, without the recording's."""
    residuals, shares = None, dict[str, dict[str, float]]()
    if state is not None:
        problem, x, covariance = state
        residuals = _residuals(blocks, x, problem)
        shares = sigma_shares(problem, x, covariance)
    return Collected(
        config=config,
        result=result,
        estimates=() if result.estimate is None else (result.estimate,),
        blocks=blocks,
        residuals=residuals,
        shares=shares,
        events=result.events,
        versions=versions(),
    )


def _residuals(blocks: Sequence[Block], x: FloatArray, problem: Problem) -> ChannelResiduals | None:
    try:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            return channel_residuals(blocks, x, problem)
    except ValueError:  # LinAlgError: the base has no inertia at this state
        return None


def sigma_shares(
    problem: Problem, x: FloatArray, covariance: FloatArray
) -> dict[str, dict[str, float]]:
    """Return the share by which each variance would fall if one cause were known exactly.

    Parameters
    ----------
    x, covariance : the whole state (p,), (p, p)

    Returns
    -------
    By quantity of the unknown bodies, such as `target.mass_kg`, and by cause: share of the variance
    in [0, 1]. Shares of correlated causes overlap; noise of the sensors is the unexplained rest.
    """
    causes = _causes(problem)
    shares: dict[str, dict[str, float]] = {}
    for body in problem.unknown:
        own = problem.body(body)
        T = report_jacobian(x[own])
        variance = np.diag(T @ covariance[own, own] @ T.T)
        for cause, places in causes.items():
            across = T @ covariance[own, places]
            within = covariance[np.ix_(places, places)]
            removed = np.sum(across * np.linalg.lstsq(within, across.T)[0].T, axis=1)
            for row, name in ((0, "mass_kg"), (1, "com_m"), (4, "inertia_kg_m2")):
                rows = slice(row, {0: 1, 1: 4, 4: 10}[row])
                share = float(np.clip(np.max(removed[rows] / variance[rows]), 0.0, 1.0))
                shares.setdefault(f"{body}.{name}", {})[cause] = share
    return shares


def _causes(problem: Problem) -> dict[str, IndexArray]:
    """Return the states by the cause under which their group counts."""
    found: dict[str, list[int]] = {}
    for k in range(problem.bodies.stop, len(problem.names)):
        group = group_of(problem.names[k])
        if group is not None:
            found.setdefault(group.cause or group.effect, []).append(k)
    return {cause: np.array(states) for cause, states in found.items()}


def versions() -> dict[str, str]:
    """Return the versions of this package and the libraries behind a result, by name."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "unknown"
    return found
