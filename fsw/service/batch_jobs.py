"""Batch jobs: the commands that start, abort and adopt a job, and the worker process."""

import json
import os
import pickle
import signal
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from itertools import count
from pathlib import Path
from typing import Any

from fsw.config import Config
from fsw.errors import CommandError
from fsw.estimators.parameter_verdicts import usable
from fsw.exchange.tied import module_command
from fsw.messages import Estimate
from fsw.messages.commands import (
    JOBS,
    BatchRequest,
    Code,
    Command,
    CommandName,
    JobReport,
    PlanRequest,
)
from fsw.service.worker import Job

PLANS = "plans"  # folder in the file directory
Report = Callable[[str, str, str], None]  # severity, code, text


class BatchJobs:
    """Runs at most one batch job, in a separate process.

    Parameters
    ----------
    config : configuration of the next job; the owner may replace the attribute
    blocks : path of the block store
    report : receives severity, code and text of events when a job ends
    """

    def __init__(self, config: Config, blocks: Path, report: Report) -> None:
        self.config = config
        self._blocks, self._report = blocks, report
        self._process: subprocess.Popen[bytes] | None = None
        self._buffer = b""
        self._newest: JobReport | None = None
        self._result: Mapping[str, Any] | None = None
        self.estimate: Estimate | None = None  # newest published estimate, the start of a plan

    @property
    def is_running(self) -> bool:
        """Whether a job has not reported its end yet."""
        return self._newest is not None and self._newest.state == "running"

    def summary(self) -> dict[str, Any] | None:
        """Return the newest report as plain values; None before the first job."""
        return None if self._newest is None else asdict(self._newest)

    def carry_out(self, command: Command) -> Command | None:
        """Execute a command of batch jobs.

        Returns
        -------
        The command that the loop must execute: ADOPT with the newest result, any command of
        another kind unchanged; None when the command is done.

        Raises
        ------
        CommandError JOB_RUNNING, NO_JOB, NO_RESULT, or FAILED when no worker can be started.
        """
        if command.name in JOBS:
            self._start(command)
            return None
        if command.name is CommandName.ABORT_BATCH:
            self._abort()
            return None
        if command.name is CommandName.ADOPT and "result" not in command.args:
            if self._result is None:
                raise CommandError(Code.NO_RESULT, "no batch job has ended with a result")
            return replace(command, args={"result": dict(self._result)})
        return command

    def poll(self) -> list[JobReport]:
        """Return the worker's new reports; add a failure if the worker ended without a result."""
        process = self._process
        if process is None or process.stdout is None:
            return []
        code = process.poll()  # before the read, so that its last lines are read too
        self._buffer += process.stdout.read() or b""
        *lines, self._buffer = self._buffer.split(b"\n")
        reports = [self._follow(json.loads(line)) for line in lines]
        if code is not None:
            if self.is_running:
                failed = ("failed", f"worker ended with {code}")
                state, text = ("aborted", "") if code == -signal.SIGTERM else failed
                reports.append(self._follow({"state": state, "progress": 0.0, "text": text}))
            self.close()
        return reports

    def close(self) -> None:
        """Terminate the worker, if any, and wait for its end."""
        process, self._process = self._process, None
        if process is not None:
            process.terminate()
            process.wait()
            if process.stdout is not None:
                process.stdout.close()

    def _start(self, command: Command) -> None:
        if self.is_running and self._newest is not None:
            raise CommandError(Code.JOB_RUNNING, f"job {self._newest.id} is running")
        is_batch = command.name is CommandName.RUN_BATCH
        request = self._batch(command) if is_batch else self._plan(command)
        self.close()
        try:
            self._process = _worker(Job(config=self.config, request=request, blocks=self._blocks))
        except OSError as error:
            text = f"worker cannot be started: {error.strerror or error}"
            raise CommandError(Code.FAILED, text) from error
        self._buffer = b""
        self._result = None if is_batch else self._result
        self._newest = JobReport(id=request.id, state="running", progress=0.0)

    def _batch(self, command: Command) -> BatchRequest:
        strange = set(command.args["unknown"]) - set(self.config.bodies)
        if strange:
            text = f"unknown {sorted(strange)}: the bodies are {sorted(self.config.bodies)}"
            raise CommandError(Code.BAD_ARGUMENT, text)
        return BatchRequest(
            id=command.id,
            method=str(command.args["method"]),
            unknown=tuple(command.args["unknown"]),
            last_s=command.args.get("last_s"),
        )

    def _plan(self, command: Command) -> PlanRequest:
        """Return the request of a motion from the newest estimate, with a new name for its file.

        Raises
        ------
        CommandError NOT_SUPPORTED without limits, NO_RESULT without a usable estimate.
        """
        estimate, args = self.estimate, command.args
        if self.config.excitation is None:
            text = "excitation.limits: missing; which limits hold is never assumed"
            raise CommandError(Code.NOT_SUPPORTED, text)
        if estimate is None or not estimate.bodies:
            raise CommandError(Code.NO_RESULT, "no estimate has been published yet")
        if not usable(estimate.reasons):
            text = f"the estimate is not usable: {', '.join(estimate.reasons)}"
            raise CommandError(Code.NO_RESULT, text)
        taken = {path.name for path in self._plans.glob("plan_*.yaml")}
        name = next(name for k in count(1) if (name := f"plan_{k:04d}.yaml") not in taken)
        return PlanRequest(
            id=command.id,
            duration_s=args["duration_s"],
            starts=args["starts"],
            seed=args["seed"],
            unknown=tuple(estimate.bodies),
            posterior={
                "names": estimate.names,
                "mean": estimate.mean,
                "covariance": estimate.covariance,
            },
            out=self._plans / name,
        )

    @property
    def _plans(self) -> Path:
        """Folder of the planned motions, from which file delivery sends them."""
        config = self.config
        files = "files" if config.telemetry is None else config.telemetry.file_directory
        return config.resolve(config.service.state_directory) / files / PLANS

    def _abort(self) -> None:
        if self._process is None or not self.is_running:
            raise CommandError(Code.NO_JOB, "no batch job is running")
        self._process.terminate()

    def _follow(self, values: Mapping[str, Any]) -> JobReport:
        job = self._newest.id if self._newest is not None else 0
        report = JobReport(id=job, **values)
        self._newest = report
        result = report.result or {}
        if report.state == "done" and "mean" in result:
            self._result = report.result
        for change in result.get("changes", ()):
            self._report("info", "PLAN_WRITTEN", f"{PLANS}/{report.text}: {change}")
        if report.state != "running":
            severity = "info" if report.state == "done" else "medium"
            text = f"batch job {job} {report.state}" + (f": {report.text}" if report.text else "")
            self._report(severity, "BATCH_" + report.state.upper(), text)
        return report


def _worker(job: Job) -> subprocess.Popen[bytes]:
    """Start a worker process and send it the job. Raises OSError."""
    process = subprocess.Popen(
        [*module_command("fsw.service.worker"), str(os.getpid())],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    )
    if process.stdin is None or process.stdout is None:
        raise OSError("worker has no pipes")
    os.set_blocking(process.stdout.fileno(), False)
    try:
        process.stdin.write(pickle.dumps(job))
        process.stdin.close()
    except BrokenPipeError:
        pass  # the worker ended at once; the next poll reports it
    return process
