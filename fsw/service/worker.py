"""The batch worker: one job in a process of its own at nice 19.

`python -m fsw.service.worker PID` reads one pickled `Job` from standard input, writes JSON lines:
progress, then the result or the failure. SIGTERM ends it, and so does the end of process PID.
"""

from __future__ import annotations

import ctypes
import json
import os
import pickle
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from fsw.config import Config
from fsw.messages import Block
from fsw.messages.commands import BatchRequest, JobReport
from fsw.messages.errors import ConfigError, EstimatorError
from fsw.service.blockstore import BlockStoreError, read_blocks

NICE = 19
_PR_SET_PDEATHSIG = 1  # prctl(2)
Progress = Callable[[float, str], bool]  # done ratio, what is being done; False: stop
RunBatch = Callable[[Config, Sequence[Block], str, tuple[str, ...], Progress], Mapping[str, Any]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """Input of the worker."""

    config: Config
    request: BatchRequest
    blocks: Path


def default_batch(
    config: Config,
    blocks: Sequence[Block],
    method: str,
    unknown: tuple[str, ...],
    progress: Progress,
) -> Mapping[str, Any]:
    """Run a batch method of the estimators."""
    from fsw.estimators.batch.run import run_batch

    return run_batch(config, blocks, method, unknown, progress)


def run_job(
    config: Config,
    blocks: Sequence[Block],
    request: BatchRequest,
    progress: Progress,
    run: RunBatch,
) -> JobReport:
    """Run one job to its end; what data or configuration cannot give is a failed job."""
    unknown = request.unknown or tuple(config.unknown)
    try:
        if not blocks:
            raise EstimatorError("NO_DATA: no block in the requested window")
        result = run(config, blocks, request.method, unknown, progress)
    except (ConfigError, EstimatorError) as error:
        return JobReport(id=request.id, state="failed", progress=1.0, text=str(error))
    return JobReport(id=request.id, state="done", progress=1.0, result=result)


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

    try:
        blocks = read_blocks(job.blocks, last_s=job.request.last_s)
    except BlockStoreError as error:
        report = JobReport(id=job.request.id, state="failed", progress=1.0, text=str(error))
    else:
        report = run_job(config, blocks, job.request, progress, default_batch)
    tell(report)
    return 0 if report.state == "done" else 1


def end_with(service: int) -> None:
    """Have the kernel end this process with the service; end now if that has ended already."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != service:
        os._exit(1)


if __name__ == "__main__":
    end_with(int(sys.argv[1]))
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    os.nice(NICE)
    sys.exit(main(sys.stdin.buffer, sys.stdout))
