"""Typed commands: a JSON line or telecommand becomes a `Command`, or a refusal with a code."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

from fsw.errors import CommandError, brief

METHODS = ("mrnea", "rda", "cm", "ce", "fused")
BODIES = ("base", "target")
BODY_NAME = re.compile(r"[a-z][a-z0-9_]{0,31}")
MAX_LINE_BYTES = 65536
MAX_LAST_S = 1e6  # the same limit as in the telecommand RUN_BATCH
# arguments of RUN_PLAN: least, most, whether a whole number; as in the telecommand RUN_PLAN
PLAN_BOUNDS = {
    "duration_s": (1.0, 300.0, False),
    "starts": (1, 64, True),
    "seed": (0, 65535, True),
}
PLAN_DEFAULTS = {"duration_s": 60.0, "starts": 1, "seed": 0}


class CommandName(StrEnum):
    """Commands of the daemon."""

    STATUS = "status"  # answered by the service from the newest summary
    RESET = "reset"  # estimator back to its prior
    FINISH = "finish"  # re-linearise until the estimate converges, and publish
    REPORT = "report"  # diagnosis of the current estimate, in numbers and words
    RUN_BATCH = "run_batch"  # start a batch job on recorded blocks
    RUN_PLAN = "run_plan"  # start a batch job that plans a motion from the present estimate
    ABORT_BATCH = "abort_batch"
    ADOPT = "adopt"  # make the last batch result the online estimator's prior
    REST = "rest"  # windows are stored but no longer used for identification
    RESUME = "resume"  # continue identifying
    CONFIGURE = "configure"  # other unknowns, noise, robot or settings: begin at the prior
    SAVE_STATE = "save_state"  # write a checkpoint now, and keep the state for RESTORE_STATE
    RESTORE_STATE = "restore_state"  # back to the state that was saved, or restored at the start
    RESTART = "restart"  # end and start again
    STOP = "stop"  # end the daemon as SIGTERM does


JOBS = (CommandName.RUN_BATCH, CommandName.RUN_PLAN)  # commands that begin a job, which ends later


class Code(StrEnum):
    """Why a command was accepted or refused."""

    ACCEPTED = "ACCEPTED"
    MALFORMED = "MALFORMED"
    UNKNOWN_COMMAND = "UNKNOWN_COMMAND"
    BAD_ARGUMENT = "BAD_ARGUMENT"
    QUEUE_FULL = "QUEUE_FULL"
    JOB_RUNNING = "JOB_RUNNING"
    NO_JOB = "NO_JOB"
    NO_RESULT = "NO_RESULT"
    NO_STATE = "NO_STATE"
    NOT_SUPPORTED = "NOT_SUPPORTED"
    ESTIMATOR = "ESTIMATOR"
    TIMEOUT = "TIMEOUT"
    FAILED = "FAILED"  # an unforeseen error; the event COMMAND_FAILED is sent too


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """One command; its reply has the same `id`."""

    name: CommandName
    id: int = 0
    args: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """The answer to a command."""

    id: int
    command: str
    accepted: bool
    code: Code
    text: str = ""
    data: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchRequest:
    """One batch job: which method, for which bodies, on which blocks."""

    id: int
    method: str
    unknown: tuple[str, ...]
    last_s: float | None = None  # use only the newest seconds; None: use every stored block


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanRequest:
    """Request to plan one motion: its length, the search, and the file to write."""

    id: int
    duration_s: float
    starts: int
    seed: int
    unknown: tuple[str, ...]
    posterior: Mapping[str, Any]  # names, mean, covariance of the present estimate
    out: Path


@dataclass(frozen=True, slots=True, kw_only=True)
class JobReport:
    """Progress or end of a batch job; state is running, done, failed or aborted."""

    id: int
    state: str
    progress: float  # 0..1
    text: str = ""
    result: Mapping[str, Any] | None = None


def parse_command(line: bytes, command_id: int) -> Command:
    """Read one JSON line {"command": NAME, ...arguments}.

    Raises
    ------
    CommandError with code MALFORMED, UNKNOWN_COMMAND or BAD_ARGUMENT.
    """
    if len(line) > MAX_LINE_BYTES:
        raise CommandError(Code.MALFORMED, f"{len(line)} bytes; at most {MAX_LINE_BYTES}")
    try:
        data = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise CommandError(Code.MALFORMED, f"not JSON: {error}") from error
    if not isinstance(data, dict) or not isinstance(data.get("command"), str):
        raise CommandError(Code.MALFORMED, 'must be an object with the key "command"')
    text = data.pop("command").replace("-", "_").lower()
    if text not in set(CommandName):
        raise CommandError(
            Code.UNKNOWN_COMMAND,
            f"{brief(text)} is not one of {[str(name) for name in CommandName]}",
        )
    name = CommandName(text)
    if name is CommandName.RUN_BATCH:
        args = _batch_args(data)
    elif name is CommandName.RUN_PLAN:
        args = _plan_args(data)
    elif name is CommandName.CONFIGURE:
        args = _configure_args(data)
    else:
        args = _no_args(name, data)
    return Command(name=name, id=command_id, args=args)


def _no_args(name: CommandName, data: dict[str, Any]) -> dict[str, Any]:
    if data:
        raise CommandError(Code.BAD_ARGUMENT, f"{name} takes no arguments, got {sorted(data)}")
    return {}


def _batch_args(data: dict[str, Any]) -> dict[str, Any]:
    extra = set(data) - {"method", "unknown", "last_s"}
    if extra:
        raise CommandError(
            Code.BAD_ARGUMENT, f"run_batch takes method, unknown, last_s; got {sorted(extra)}"
        )
    method = data.get("method")
    if method not in METHODS:
        raise CommandError(
            Code.BAD_ARGUMENT, f"method {brief(method)} is not one of {list(METHODS)}"
        )
    unknown = _unknown(data)
    last_s = data.get("last_s")
    if last_s is not None and not _is_duration(last_s):
        text = f"last_s {brief(last_s)}: must be a number above 0, at most {MAX_LAST_S:g}"
        raise CommandError(Code.BAD_ARGUMENT, text)
    return {"method": method, "unknown": unknown, "last_s": last_s}


def _plan_args(data: dict[str, Any]) -> dict[str, Any]:
    extra = set(data) - set(PLAN_BOUNDS)
    if extra:
        text = f"run_plan takes {', '.join(PLAN_BOUNDS)}; got {sorted(extra)}"
        raise CommandError(Code.BAD_ARGUMENT, text)
    args = PLAN_DEFAULTS | data
    for key, (least, most, whole) in PLAN_BOUNDS.items():
        value = args[key]
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not least <= value <= most or (whole and value != int(value)):
            kind = "a whole number" if whole else "a number"
            text = f"{key} {brief(value)}: must be {kind}, {least:g} to {most:g}"
            raise CommandError(Code.BAD_ARGUMENT, text)
        args[key] = int(value) if whole else float(value)
    return args


def _is_duration(value: Any) -> bool:  # noqa: ANN401
    """Return whether a value is a number above 0 and at most MAX_LAST_S; bool and NaN are not."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and 0 < value <= MAX_LAST_S


def _configure_args(data: dict[str, Any]) -> dict[str, Any]:
    extra = set(data) - {"unknown"}
    if extra:
        raise CommandError(Code.BAD_ARGUMENT, f"configure takes unknown, got {sorted(extra)}")
    return {"unknown": _unknown(data)}


def _unknown(data: dict[str, Any]) -> list[str]:
    unknown = data.get("unknown", [])
    if isinstance(unknown, str):
        unknown = list(BODIES) if unknown == "both" else [unknown]
    if not isinstance(unknown, list) or not all(_is_name(body) for body in unknown):
        raise CommandError(
            Code.BAD_ARGUMENT,
            f"unknown {brief(unknown)}: must be base, target, both or a list of bodies",
        )
    return [str(body) for body in unknown]


def _is_name(value: Any) -> bool:  # noqa: ANN401
    """Return whether a value has the form of a body's name; the body need not exist."""
    return isinstance(value, str) and BODY_NAME.fullmatch(value) is not None
