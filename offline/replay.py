"""Replay: run the daemon's estimation on a recording, fast and with the same result as live.

Recorded frames and chunks are passed on in batches with their recorded stamps, as the loop does.
Results depend on the stamps alone, not on the length of a batch.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fsw.clock import MonotonicClock
from fsw.config import Config
from fsw.drivers.sources.devices import DEVICE_SAMPLES
from fsw.drivers.wire import NO_FRAMES, ByteChunk, FrameArray, joined
from fsw.errors import WRONG_CONTENT, ConfigError, brief
from fsw.estimation.estimation import Estimation
from fsw.estimators.pipeline import Pipeline
from fsw.exchange.checkpoint import decode
from fsw.exchange.columns import Column, frames_of
from fsw.exchange.recording import (
    END_NS,
    SAMPLED,
    SAMPLES,
    Contents,
    Piece,
    RecordedMessage,
    messages_of,
    pieces_of,
)
from fsw.exchange.recording_parts import contents_of, parts_of
from fsw.exchange.restart import Mode, Restart
from fsw.exchange.sinks import (
    JOINTS,
    BatchEnd,
    CanTraffic,
    Fanout,
    Message,
    NullSink,
    SerialTraffic,
    Sink,
)
from fsw.messages import Event
from fsw.messages.commands import Command, CommandName
from fsw.service.recorder import CHECKPOINT
from offline.replay_result import ReplayResult
from offline.span import WHOLE, Span
from offline.unused import missed, unused_lines

BATCH_NS = 400_000_000
LONGEST_GAP_NS = 3600 * 10**9  # replayed of a gap without messages
WINDOWS_BATCH_NS = 10 * 10**9  # if only windows are wanted: times of estimates do not matter
PROGRESS_NS = 10 * 10**9
CAN_TOPIC = "/can/"
REPLAYED = (
    CommandName.RESET,
    CommandName.FINISH,
    CommandName.ADOPT,
    CommandName.REST,
    CommandName.RESUME,
    CommandName.CONFIGURE,
    CommandName.SAVE_STATE,
    CommandName.RESTORE_STATE,
)


Traffic = FrameArray | list[ByteChunk]


class _Track:
    """Messages of one topic that `take` has not returned yet; the first of them are available."""

    def __init__(self, *, is_bus: bool) -> None:
        self._is_bus = is_bus
        self._times_ns = np.empty(0, np.int64)
        self._waiting: Traffic = NO_FRAMES if is_bus else []
        self._available = 0
        self._added: list[Column] = []  # messages not yet sorted into `_waiting`

    def add(self, column: Column) -> None:
        """Add the messages of a piece; they are sorted by time, equal times in file order."""
        self._added.append(column)

    def _put_in_order(self) -> None:
        waiting: Traffic
        if isinstance(self._waiting, list):
            waiting = [*self._waiting, *(c for column in self._added for c in column.chunks())]
            times_ns = np.array([chunk.t_ns for chunk in waiting], np.int64)
        else:
            waiting = joined([self._waiting, frames_of(self._added)])
            times_ns = waiting["t_ns"]
        self._added = []
        if np.count_nonzero(times_ns[1:] < times_ns[:-1]):
            order = np.argsort(times_ns, kind="stable")
            times_ns = times_ns[order]
            waiting = (
                [waiting[k] for k in order] if isinstance(waiting, list) else waiting.take(order)
            )
        self._times_ns, self._waiting = times_ns, waiting

    def next_ns(self) -> int:
        """Return the time of the first message not available yet [ns]; END_NS: there is none."""
        if self._added:
            self._put_in_order()
        rest = self._times_ns[self._available :]
        return int(rest[0]) if rest.size else END_NS

    def release(self, until_ns: int) -> None:
        """Make all messages stamped at or before `until_ns` available."""
        if self._added:
            self._put_in_order()
        self._available = int(np.searchsorted(self._times_ns, until_ns, side="right"))

    def newest_ns(self) -> int:
        """Return the time of the newest available message [ns]; 0: there is none."""
        return int(self._times_ns[self._available - 1]) if self._available else 0

    def take(self) -> Traffic:
        """Return the available messages and remove them."""
        count, self._available = self._available, 0
        taken, self._waiting = self._waiting[:count], self._waiting[count:]
        self._times_ns = self._times_ns[count:]
        return taken


class RecordingFeed:
    """Messages of a recording, yielded in batches; `now_ns` is the end of the last batch."""

    def __init__(self, pieces: Iterator[tuple[Piece, int]], topics: Sequence[str]) -> None:
        self._pieces = pieces
        self._tracks = {t: _Track(is_bus=t.startswith(CAN_TOPIC)) for t in topics}
        self._known_ns = -1  # all messages before this time have been read
        self._more()
        first_ns = min(track.next_ns() for track in self._tracks.values())
        self.now_ns = first_ns if first_ns < END_NS else 0

    @property
    def exhausted(self) -> bool:
        """Whether no message is left to yield."""
        return self._known_ns == END_NS and all(
            track.next_ns() == END_NS for track in self._tracks.values()
        )

    def _more(self) -> None:
        """Read the next piece."""
        piece, self._known_ns = next(self._pieces, (None, END_NS))
        if piece is not None:
            for topic, column in piece.read().items():
                self._tracks[topic].add(column)

    def next_batch(self, batch_ns: int) -> Iterator[Message]:
        """Yield the messages of the next `batch_ns`, as `until`.

        Of a gap without messages the last `LONGEST_GAP_NS` are replayed.
        """
        nearest_ns = min(self._known_ns, *(track.next_ns() for track in self._tracks.values()))
        gap_ns = 0 if self.exhausted else nearest_ns - LONGEST_GAP_NS - self.now_ns
        return self.until(self.now_ns + max(batch_ns, gap_ns))

    def until(self, until_ns: int) -> Iterator[Message]:
        """Yield all messages stamped at or before `until_ns`, then the end of the batch.

        `now_ns` does not pass the last message of the recording.
        """
        while self._known_ns <= until_ns:
            self._more()
        for track in self._tracks.values():
            track.release(until_ns)
        newest_ns = max(track.newest_ns() for track in self._tracks.values())
        self.now_ns = max(self.now_ns, newest_ns if self.exhausted else until_ns)
        for topic, track in self._tracks.items():
            name = topic.rsplit("/", 1)[1]
            taken = track.take()
            if isinstance(taken, list):
                yield SerialTraffic(name, taken)
            else:
                yield CanTraffic(name, taken)
        yield BatchEnd(now_ns=self.now_ns)


class _EventCollector(NullSink):
    """Keeps the events of a replay."""

    def __init__(self) -> None:
        self.events: list[Event] = []

    def put(self, message: Message) -> None:
        """Keep an event; discard every other message."""
        if isinstance(message, Event):
            self.events.append(message)


def replay(
    recording: Path,
    config: Config,
    *,
    sink: Sink | None = None,
    traffic: Sink | None = None,
    pipeline: Pipeline | None = None,
    span: Span = WHOLE,
    progress: Callable[[str], None] = lambda _text: None,
    windows_only: bool = False,
) -> ReplayResult:
    """Run the daemon's estimation on a recording and return its result.

    Parameters
    ----------
    sink : receives the output, such as blocks, estimates and events; None: only the result is kept
    traffic : receives the same input messages as the estimation; None: there is no such receiver
    pipeline : conditioning and estimation; None: as the configuration says
    span : the part to replay; only a replay of the whole uses recorded commands and checkpoint
    progress : called with a line of text every ten seconds of the recording
    windows_only : run no recursive estimator, unless the recording contains commands for it

    Raises
    ------
    ConfigError when the recording cannot be read, is of another robot, lacks a configured channel
    or SYNC, or has no message in the span.
    """
    wall = MonotonicClock()
    began_ns = wall.now_ns()
    parts = parts_of(recording)
    held = contents_of(parts)
    topics = topics_of(config, held.topics)
    _refuse_missing(recording, parts, topics, held)
    _refuse_other_robot(recording, config, held.metadata.get(SAMPLED, {}).get(JOINTS))
    pieces = list(span.pieces(pieces_of(parts, topics)))
    feed = RecordingFeed(iter(pieces), topics)
    if feed.exhausted:
        raise ConfigError(f"{recording}: holds no message of its sensors{span.words()}")
    collector, start_ns = _EventCollector(), feed.now_ns
    estimation = Estimation(
        config,
        lambda: feed.now_ns,
        Fanout(collector, *([] if sink is None else [sink])),
        pipeline=pipeline,
        sampled=[t.removeprefix(SAMPLES) for t in topics if t.startswith(SAMPLES)],
        replays=True,
    )
    whole = "/tc" in held.topics and span == WHOLE
    commands = list(messages_of(parts, ["/tc"])) if whole else []
    end_ns = _plan(estimation, commands, held.attachments.get(CHECKPOINT))
    batch_ns = BATCH_NS
    if windows_only and len(commands) == (end_ns is not None):
        estimation.dispatcher.identifying, batch_ns = False, WINDOWS_BATCH_NS
    said_ns = start_ns
    while not feed.exhausted:
        for message in feed.next_batch(batch_ns):
            estimation.put(message)
            if traffic is not None:
                traffic.put(message)
        if feed.now_ns >= said_ns + PROGRESS_NS:
            said_ns += (feed.now_ns - said_ns) // PROGRESS_NS * PROGRESS_NS
            progress(_replayed(said_ns, start_ns, pieces[-1][0].start_ns))
    if end_ns is not None:
        feed.now_ns = max(feed.now_ns, end_ns)
        estimation.put(BatchEnd(now_ns=feed.now_ns))
    if not estimation.aligner.started:
        raise ConfigError(f"{recording}: no SYNC frame (0x080) on {', '.join(topics)}")
    estimation.apply_planned(estimation.aligner.next_index)
    estimate, status = estimation.shutdown(), estimation.status()
    return ReplayResult(
        diagnosis=estimation.diagnosis() if estimate is not None else None,
        estimate=estimate,
        unknown=tuple(config.unknown),
        method=estimate.method if estimate is not None else config.estimator.method,
        status=status,
        missed=missed(status, config, config.estimator.method),
        truncated=held.truncated,
        dropped=int(held.metadata.get("recorder", {}).get("dropped", "0")),
        wall_s=(wall.now_ns() - began_ns) * 1e-9,
        events=tuple(collector.events),
        start_ns=start_ns,
        duration_s=(feed.now_ns - start_ns) * 1e-9,
        least_windows=config.estimator.settle_blocks,
    )


def _replayed(now_ns: int, start_ns: int, last_ns: int) -> str:
    """Return the progress in words; `last_ns` is the start of the last piece of the recording."""
    words = f"{(now_ns - start_ns) // 10**9} s replayed"
    if last_ns <= start_ns:  # a file that is cut off is one piece
        return words
    return f"{words} ({min(1.0, (now_ns - start_ns) / (last_ns - start_ns)):.0%})"


def doubts_of(recording: Path, config: Config) -> list[str]:
    """Return a line for each unusable sensor of a new recording, and for each jump of its clock."""
    try:
        found = replay(recording, config, windows_only=True)
    except ConfigError as error:
        return str(error).splitlines()
    jumps = [event.text for event in found.events if event.code == "WINDOWS_SKIPPED"]
    return [*unused_lines(found.status), *jumps]


def topics_of(config: Config, held: Sequence[str]) -> list[str]:
    """Return the channels to replay: decoded samples of a source if recorded, else raw traffic."""
    topics = [
        f"/can/{bus.name}" if bus.feed is None else f"/serial/{bus.name}" for bus in config.buses
    ]
    sampled = [name for name in DEVICE_SAMPLES if getattr(config, name)]
    joints, own_joints = f"{SAMPLES}{JOINTS}", bool(config.joints)
    has_buses = joints not in held and (own_joints or not set(topics).isdisjoint(held))
    if has_buses:
        sampled = [name for name in sampled if name not in config.actuators]
    else:
        topics = [joints] * own_joints
    topics += [f"{SAMPLES}{name}" for name in sampled]
    for own in config.sensors:
        topic = f"{SAMPLES}{own.name}"
        if topic in held or (own.bus is not None and not has_buses):
            topics.append(topic)
        elif own.bus is None:
            topics.append(f"/serial/{own.name}")
    return topics


def _refuse_missing(
    recording: Path, parts: Sequence[Path], topics: Sequence[str], held: Contents
) -> None:
    """Raise ConfigError if the recording lacks one of the channels to replay."""
    missing = [topic for topic in topics if topic not in held.topics]
    if held.truncated and not held.topics:
        size = sum(part.stat().st_size for part in parts)
        raise ConfigError(f"{recording}: cut off after {size} bytes, before its first data")
    if missing:
        raise ConfigError(
            f"{recording}: no channel {', '.join(missing)} as the configuration has it; "
            f"found: {', '.join(sorted(held.topics)) or 'none'}"
            f"{'; the file is cut off' if held.truncated else ''}"
        )


def _refuse_other_robot(recording: Path, config: Config, sampled: str | None) -> None:
    """Raise ConfigError if the decoded joints `sampled` are not those of the configuration."""
    names = " ".join(sorted(joint.name for joint in config.joints))
    if sampled is not None and sorted(sampled.split()) != sorted(names.split()):
        raise ConfigError(
            f"{recording}: holds the joints {sampled}; {config.name} has {names}: the recording of "
            "another robot"
        )


def _plan(
    estimation: Estimation, commands: Sequence[RecordedMessage], checkpoint: bytes | None
) -> int | None:
    """Schedule the recorded commands; return the end of the run [ns], None if it was killed.

    If the run had continued from a checkpoint, the replay starts from the same checkpoint.
    """
    end_ns = None
    for record in commands:
        try:
            if _plan_one(estimation, json.loads(record.data), checkpoint):
                end_ns = record.t_ns
        except WRONG_CONTENT as error:
            words = f"/tc at {record.t_ns} ns is not a command of this software: {brief(error)}"
            raise ConfigError(f"{words}; the recording is damaged") from error
    return end_ns


def _plan_one(estimation: Estimation, values: dict[str, Any], checkpoint: bytes | None) -> bool:
    """Schedule one recorded command; return whether it is the end of the run."""
    if values.get("command") == "restart" and checkpoint is not None:
        found = Restart(checkpoint=decode(checkpoint), mode=Mode(values["mode"]), age_s=None)
        estimation.restart(found)
    elif values.get("command") == "end":
        estimation.window_limit = int(values["next_window"])
        return True
    elif values.get("command") in REPLAYED:
        name = CommandName(values["command"])
        command = Command(name=name, id=int(values["id"]), args=dict(values["args"]))
        windows = int(values["next_window"]), int(values.get("clean_window", 0))
        estimation.dispatcher.plan(windows[0], command, windows[1])
    return False
