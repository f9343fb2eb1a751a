"""The batch worker: one job in a separate process at nice 19.

`python -m fsw.service.worker PID` reads one pickled `Job` from standard input and writes JSON
lines: progress, then the result or the failure. It ends at SIGTERM or when process PID ends.
"""

import json
import os
import pickle
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from file_delivery.extras import needs
from fsw.config import Config
from fsw.errors import ConfigError, EstimatorError, FswError
from fsw.exchange.tied import end_with
from fsw.messages import Block
from fsw.messages.commands import BatchRequest, JobReport, PlanRequest
from fsw.service.blockstore import BlockStoreError, read_blocks

NICE = 19
Progress = Callable[[float, str], bool]  # ratio done, current step; False: stop
RunBatch = Callable[[Config, Sequence[Block], str, tuple[str, ...], Progress], Mapping[str, Any]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """Input of the worker; `blocks` is the path of the block store."""

    config: Config
    request: BatchRequest | PlanRequest
    blocks: Path


def default_batch(
    config: Config,
    blocks: Sequence[Block],
    method: str,
    unknown: tuple[str, ...],
    progress: Progress,
) -> Mapping[str, Any]:
    """Run a batch method of `fsw.estimators`; return its result as plain values."""
    from fsw.estimators.batch.run import run_batch

    return run_batch(config, blocks, method, unknown, progress)


def run_job(
    config: Config,
    blocks: Sequence[Block],
    request: BatchRequest,
    progress: Progress,
    run: RunBatch,
) -> JobReport:
    """Run one batch job; report it as failed if data or configuration do not allow a result."""
    unknown = request.unknown or tuple(config.unknown)
    try:
        if not blocks:
            raise EstimatorError("NO_DATA: no block in the requested window")
        result = run(config, blocks, request.method, unknown, progress)
    except (ConfigError, EstimatorError) as error:
        return JobReport(id=request.id, state="failed", progress=1.0, text=str(error))
    return JobReport(id=request.id, state="done", progress=1.0, result=result)


def run_plan(config: Config, request: PlanRequest, progress: Progress) -> JobReport:
    """Plan a motion and write its file; report the job as failed if that is not possible."""
    progress(0.0, "laying out")
    try:
        result = _planned(config, request, progress)
    except ImportError as error:
        text = needs("RUN_PLAN", str(error.name), "excite")
    except OSError as error:
        text = f"{request.out}: {error.strerror or error}"
    except (FswError, np.linalg.LinAlgError) as error:
        text = str(error)
    else:
        return JobReport(
            id=request.id, state="done", progress=1.0, text=request.out.name, result=result
        )
    return JobReport(id=request.id, state="failed", progress=1.0, text=text)


def _planned(config: Config, request: PlanRequest, progress: Progress) -> Mapping[str, Any]:
    from planner.motion import bounds, planned
    from planner.request import MotionRequest
    from planner.subject import build_subject

    own = config.excitation
    if own is None:
        raise ConfigError("excitation.limits: missing; which limits hold is never assumed")
    config = config.with_unknown(request.unknown)
    asked = MotionRequest(
        duration_s=request.duration_s,
        starts=request.starts,
        jobs=own.jobs,
        seed=request.seed,
    )
    seen = 0

    def report(text: str) -> None:
        nonlocal seen
        seen += 1
        ratio = 0.5 * seen / asked.evaluations  # half: the wide prior is planned first
        progress(min(ratio, 0.99), text)

    subject = build_subject(config, after=request.posterior, seed=asked.seed)
    limits, collisions = bounds(config, subject, config.resolve(own.limits), report)
    motion = planned(subject, limits, collisions, asked, report)
    motion.save_spline(request.out, "RUN_PLAN")
    return {
        "method": "plan",
        "status": "OK",
        "unknown": list(request.unknown),
        "duration_s": request.duration_s,
        **motion.bodies(),
        "changes": motion.changes(),
    }


def main(source: IO[bytes], target: IO[str]) -> int:
    """Run the job on standard input; return the exit code."""
    job: Job = pickle.load(source)
    config = job.config

    def tell(report: JobReport) -> None:
        values = {"state": report.state, "progress": report.progress, "text": report.text}
        target.write(json.dumps(values | {"result": report.result}) + "\n")
        target.flush()

    def progress(ratio: float, text: str) -> bool:
        tell(JobReport(id=job.request.id, state="running", progress=ratio, text=text))
        return True

    request = job.request
    if isinstance(request, PlanRequest):
        report = run_plan(config, request, progress)
    else:
        try:
            blocks = read_blocks(job.blocks, last_s=request.last_s)
        except BlockStoreError as error:
            report = JobReport(id=request.id, state="failed", progress=1.0, text=str(error))
        else:
            report = run_job(config, blocks, request, progress, default_batch)
    tell(report)
    return 0 if report.state == "done" else 1


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # children inherit the service's SIG_IGN
    end_with(int(sys.argv[1]))
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    os.nice(NICE)
    sys.exit(main(sys.stdin.buffer, sys.stdout))
