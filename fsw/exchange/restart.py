"""Continuation after a restart: snapshots of the estimator, and how much of one is used."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Protocol, runtime_checkable

from fsw.errors import WRONG_CONTENT, EstimatorError
from fsw.exchange.checkpoint import Checkpoint
from fsw.exchange.sinks import AppliedCommand, Sink, StateRestored
from fsw.messages import Block, Estimate, Event, Snapshot
from fsw.scheduler.align import Aligner

BODY_STATES = 10  # states of each body; they come before all others


class Mode(StrEnum):
    """How much of a checkpoint is used."""

    EXACT = "exact"  # continue as if nothing had happened
    BODIES = "bodies"  # only the estimate of the bodies; the sensors may have changed


@runtime_checkable
class Restorable(Protocol):
    """An estimator whose state can be saved and restored."""

    @property
    def blocks(self) -> tuple[Block, ...]:
        """Return the blocks the state refers to."""
        ...

    def snapshot(self) -> Mapping[str, Any]:
        """Return the state as plain values."""
        ...

    def restore(self, values: Mapping[str, Any], blocks: Mapping[int, Block]) -> None:
        """Continue from a state. Raises EstimatorError when it does not fit."""
        ...

    def estimate(self, t_ns: int) -> Estimate:
        """Return the published view of the current state."""
        ...


class Resettable(Protocol):
    """An estimator that can begin again at its prior."""

    def reset(self) -> None:
        """Return to the prior."""
        ...


@runtime_checkable
class Adopting(Protocol):
    """An estimator that can use a batch result as its prior."""

    def adopt(self, result: Mapping[str, Any]) -> None:
        """Begin again from a batch result. Raises EstimatorError when it does not fit."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Restart:
    """A checkpoint that was found, and how much of it is used."""

    checkpoint: Checkpoint
    mode: Mode
    age_s: float | None  # None: another boot, the age is not known

    def text(self) -> str:
        """Return the text of the event."""
        number = self.checkpoint.sequence
        if self.age_s is None:
            other = "of another boot or from before a suspend"
            return f"checkpoint {number} {other}; the bodies' part of it"
        part = "all of it" if self.mode is Mode.EXACT else "the bodies' part of it"
        return f"checkpoint {number}, {self.age_s:.1f} s old; {part}"


def take(estimator: object, now_ns: int, grid_ns: int | None = None) -> Snapshot | None:
    """Return a snapshot between two windows; None if the estimator supports none."""
    if not isinstance(estimator, Restorable):
        return None
    state, blocks = estimator.snapshot(), estimator.blocks
    refers = tuple(block.index for block in blocks)
    return Snapshot(t_ns=now_ns, grid_ns=grid_ns, state=state, refers=refers, blocks=blocks)


def put_back(estimator: object, snapshot: Snapshot) -> Estimate:
    """Restore a snapshot's state in an estimator; return the estimate.

    Raises
    ------
    EstimatorError when the state does not fit, or the estimator cannot restore one.
    """
    if not isinstance(estimator, Restorable):
        raise EstimatorError("this estimator cannot restore a state")
    try:
        estimator.restore(snapshot.state, {block.index: block for block in snapshot.blocks})
    except WRONG_CONTENT as error:
        raise EstimatorError(f"the state is not one of this software: {error!r}") from error
    return estimator.estimate(snapshot.t_ns)


def put_back_bodies(estimator: object, snapshot: Snapshot) -> Estimate:
    """Use a snapshot's estimate of the bodies as prior; all other states begin at their prior.

    Raises
    ------
    EstimatorError when the state does not fit, or the estimator cannot use it as prior.
    """
    if not (isinstance(estimator, Adopting) and isinstance(estimator, Restorable)):
        raise EstimatorError("this estimator cannot use another prior")
    prior = estimator.estimate(snapshot.t_ns)
    before = put_back(estimator, snapshot)
    k = slice(0, BODY_STATES * len(before.bodies))
    mean, covariance = prior.mean.copy(), prior.covariance.copy()
    mean[k] = before.mean[k]
    covariance[k, :] = 0.0
    covariance[:, k] = 0.0
    covariance[k, k] = before.covariance[k, k]
    nothing = {"status": "OK", "names": before.names, "first_block": 0, "last_block": -1}
    estimator.adopt(nothing | {"mean": mean, "covariance": covariance})
    return estimator.estimate(snapshot.t_ns)


def judge(checkpoint: Checkpoint, boot_id: str, now_ns: int, hold_s: float) -> Restart:
    """Decide how much of a checkpoint to use: all of it only within `hold_s` and one boot."""
    if not boot_id or checkpoint.boot_id != boot_id:
        return Restart(checkpoint=checkpoint, mode=Mode.BODIES, age_s=None)
    age_s = (now_ns - checkpoint.snapshot.t_ns) * 1e-9
    mode = Mode.EXACT if 0.0 <= age_s <= hold_s else Mode.BODIES
    return Restart(checkpoint=checkpoint, mode=mode, age_s=age_s)


def resume(
    found: Restart,
    estimator: Resettable,
    aligner: Aligner,
    sink: Sink,
    now_ns: int,
    *,
    recorded: bool = True,
) -> Estimate | None:
    """Continue from a checkpoint and return the estimate; None and an event if it does not fit.

    An exact continuation keeps the grid of the windows, so that times counted from the first SYNC
    do not change.
    """
    snapshot, sequence = found.checkpoint.snapshot, found.checkpoint.sequence
    exact = found.mode is Mode.EXACT
    try:
        estimate = (put_back if exact else put_back_bodies)(estimator, snapshot)
    except EstimatorError as error:
        estimator.reset()
        sink.put(Event(now_ns, "medium", "CHECKPOINT_REFUSED", str(error)))
        return None
    if exact and snapshot.grid_ns is not None:
        aligner.resume(snapshot.grid_ns)
    if recorded:
        sink.put(StateRestored(sequence))
        record = {"command": "restart", "mode": str(found.mode), "sequence": sequence}
        sink.put(AppliedCommand(now_ns, record))
    sink.put(Event(now_ns, "info", "STATE_RESTORED", found.text()))
    return estimate
