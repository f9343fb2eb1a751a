"""The batch worker: one job in a process of its own at nice 19, and its inline twin.

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
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from fsw.config import Config
from fsw.messages import Block
from fsw.messages.commands import BatchRequest, JobReport
from fsw.messages.errors import EstimatorError
from fsw.service.blockstore import CAPACITY, BlockStoreError, newest, read_blocks

NICE = 19
_PR_SET_PDEATHSIG = 1  # prctl(2)
Progress = Callable[[float, str], bool]  # done ratio, what is being done; False: stop
RunBatch = Callable[[Config, Sequence[Block], str, tuple[str, ...], Progress], Mapping[str, Any]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """What the worker needs."""

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
    """Run one job to its end; what the data cannot give is a failed job, not an error."""
    unknown = request.unknown or tuple(config.unknown)
    try:
        if not blocks:
            raise EstimatorError("NO_DATA: no block in the window asked for")
        result = run(config, blocks, request.method, unknown, progress)
    except EstimatorError as error:
        return JobReport(id=request.id, state="failed", progress=1.0, text=str(error))
    return JobReport(id=request.id, state="done", progress=1.0, result=result)


class InlineJobs:
    """Jobs in virtual time: run inline, the result delivered after a virtual delay."""

    def __init__(self, config: Config, delay_s: float, run: RunBatch = default_batch) -> None:
        self._config = config
        self._delay_ns = round(delay_s * 1e9)
        self._run = run
        self._blocks: deque[Block] = deque(maxlen=CAPACITY)
        self._due: tuple[int, JobReport] | None = None

    def store(self, block: Block) -> None:
        """Keep a block."""
        self._blocks.append(block)

    def submit(self, request: BatchRequest, now_ns: int) -> None:
        """Run the job now, deliver later."""
        blocks = newest(list(self._blocks), request.last_s)
        report = run_job(self._config, blocks, request, _ignore, self._run)
        self._due = (now_ns + self._delay_ns, report)

    def abort(self) -> None:
        """Deliver an aborted job instead."""
        if self._due is not None:
            report = JobReport(id=self._due[1].id, state="aborted", progress=0.0)
            self._due = (0, report)

    def poll(self, now_ns: int) -> list[JobReport]:
        """Return the report when its time has come."""
        if self._due is None or now_ns < self._due[0]:
            return []
        report, self._due = self._due[1], None
        return [report]


def _ignore(_ratio: float, _text: str) -> bool:
    return True


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
