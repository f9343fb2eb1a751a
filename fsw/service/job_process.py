"""The service's end of the batch worker: starts it, reads its progress, ends it."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path

from fsw.config import Config
from fsw.messages.commands import BatchRequest, JobReport
from fsw.service.worker import Job


class JobProcess:
    """At most one worker process."""

    def __init__(self, config: Config, blocks: Path) -> None:
        self._config, self._blocks = config, blocks
        self._process: subprocess.Popen[bytes] | None = None
        self._id = 0
        self._buffer = b""
        self._ended = False

    def configured(self, config: Config) -> None:
        """Take the configuration of the next job."""
        self._config = config

    def submit(self, request: BatchRequest) -> None:
        """Start the worker on a request."""
        self.close()
        self._id, self._buffer, self._ended = request.id, b"", False
        process = subprocess.Popen(
            [sys.executable, "-m", "fsw.service.worker", str(os.getpid())],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        )
        self._process = process
        if process.stdin is None or process.stdout is None:
            raise OSError("worker has no pipes")
        os.set_blocking(process.stdout.fileno(), False)
        job = pickle.dumps(Job(config=self._config, request=request, blocks=self._blocks))
        try:
            process.stdin.write(job)
            process.stdin.close()
        except BrokenPipeError:
            return  # it died at once; poll reports that

    def abort(self) -> None:
        """End the worker; the next poll reports it."""
        if self._process is not None:
            self._process.terminate()

    def poll(self) -> list[JobReport]:
        """Return what the worker has reported; its death without a result is a failure."""
        process = self._process
        if process is None or process.stdout is None:
            return []
        code = process.poll()
        reports = []
        self._buffer += process.stdout.read() or b""
        *lines, self._buffer = self._buffer.split(b"\n")
        for line in lines:
            values = json.loads(line)
            report = JobReport(
                id=self._id,
                state=values["state"],
                progress=values["progress"],
                text=values["text"],
                result=values["result"],
            )
            self._ended |= report.state != "running"
            reports.append(report)
        if code is not None:
            if not self._ended:
                aborted = code == -15
                state = "aborted" if aborted else "failed"
                text = "" if aborted else f"worker ended with {code}"
                reports.append(JobReport(id=self._id, state=state, progress=0.0, text=text))
            self.close()
        return reports

    def close(self) -> None:
        """Make sure no worker is left."""
        process, self._process = self._process, None
        if process is not None:
            process.terminate()
            process.wait()
            if process.stdout is not None:
                process.stdout.close()
