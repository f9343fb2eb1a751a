"""Commands of batch jobs, with a worker that is a pipe: no process is started here."""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from fsw.config import Config
from fsw.errors import CommandError
from fsw.messages.commands import Code, Command, CommandName
from fsw.service import batch_jobs
from fsw.service.batch_jobs import BatchJobs
from tests.conftest import ArmProject
from tests.support.loop_cases import arm_config

ARGS = {"method": "mrnea", "unknown": ["target"], "last_s": None}
DONE = {"state": "done", "progress": 1.0, "text": "", "result": {"mean": [1.0]}}
HALF = {"state": "running", "progress": 0.5, "text": "half", "result": None}


class Pipe:
    """A worker that says what the test writes."""

    def __init__(self) -> None:
        source, self.target = os.pipe()
        os.set_blocking(source, False)
        self.stdout = os.fdopen(source, "rb", buffering=0)
        self.code: int | None = None

    def say(self, values: dict) -> None:
        os.write(self.target, json.dumps(values).encode() + b"\n")

    def poll(self) -> int | None:
        return self.code

    def terminate(self) -> None:
        self.code = -15 if self.code is None else self.code

    def wait(self) -> None:
        os.close(self.target)


@pytest.fixture
def bench(arm: ArmProject, monkeypatch: pytest.MonkeyPatch) -> Iterator[SimpleNamespace]:
    config: Config = arm_config(arm)
    found = SimpleNamespace(events=[], workers=[], jobs=None, asked=[])

    def start(job) -> Pipe:
        found.asked.append(job.request)
        found.workers.append(Pipe())
        return found.workers[-1]

    monkeypatch.setattr(batch_jobs, "_worker", start)
    report = lambda *event: found.events.append(event)  # noqa: E731
    found.jobs = BatchJobs(config, Path("blocks"), report)
    found.tell = lambda name, number=1, **args: found.jobs.carry_out(
        Command(name=name, id=number, args=args)
    )
    yield found
    found.jobs.close()


def code_of(bench: SimpleNamespace, name: CommandName, number: int = 1, **args) -> str:
    with pytest.raises(CommandError) as caught:
        bench.tell(name, number, **args)
    return caught.value.code


def test_one_job_runs_at_a_time_and_its_end_is_an_event(bench: SimpleNamespace):
    assert bench.tell(CommandName.RUN_BATCH, 3, **ARGS) is None
    assert (bench.asked[0].id, bench.asked[0].unknown) == (3, ("target",))
    assert code_of(bench, CommandName.RUN_BATCH, 4, **ARGS) == Code.JOB_RUNNING
    bench.workers[0].say(HALF)
    (report,) = bench.jobs.poll()
    assert (report.id, report.progress, bench.jobs.summary()["progress"]) == (3, 0.5, 0.5)
    assert bench.events == []
    bench.workers[0].say(DONE)
    bench.jobs.poll()
    assert [event[:2] for event in bench.events] == [("info", "BATCH_DONE")]
    assert bench.tell(CommandName.RUN_BATCH, 5, **ARGS) is None


def test_adopt_reaches_the_loop_with_the_newest_result(bench: SimpleNamespace):
    assert code_of(bench, CommandName.ADOPT) == Code.NO_RESULT
    bench.tell(CommandName.RUN_BATCH, 3, **ARGS)
    assert code_of(bench, CommandName.ADOPT) == Code.NO_RESULT
    bench.workers[0].say(DONE)
    bench.jobs.poll()
    assert bench.tell(CommandName.ADOPT).args == {"result": {"mean": [1.0]}}


def test_an_aborted_job_leaves_no_result(bench: SimpleNamespace):
    assert code_of(bench, CommandName.ABORT_BATCH) == Code.NO_JOB
    bench.tell(CommandName.RUN_BATCH, 3, **ARGS)
    bench.tell(CommandName.ABORT_BATCH)
    (report,) = bench.jobs.poll()
    assert (report.state, bench.jobs.is_running) == ("aborted", False)
    assert code_of(bench, CommandName.ADOPT) == Code.NO_RESULT
    assert [event[1] for event in bench.events] == ["BATCH_ABORTED"]


def test_a_worker_that_dies_is_a_failed_job(bench: SimpleNamespace):
    bench.tell(CommandName.RUN_BATCH, 3, **ARGS)
    bench.workers[0].code = -9
    (report,) = bench.jobs.poll()
    assert (report.state, report.text) == ("failed", "worker ended with -9")
    assert bench.jobs.poll() == []
    assert bench.tell(CommandName.RUN_BATCH, 4, **ARGS) is None


def test_a_worker_that_cannot_be_started_fails_the_command(
    bench: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
):
    def refuse(_job) -> None:
        raise OSError(11, "no process")

    monkeypatch.setattr(batch_jobs, "_worker", refuse)
    assert code_of(bench, CommandName.RUN_BATCH, 3, **ARGS) == Code.FAILED
    assert not bench.jobs.is_running


def test_a_body_that_is_not_configured_is_refused_at_once(bench: SimpleNamespace):
    args = ARGS | {"unknown": ["target", "arm"]}
    assert code_of(bench, CommandName.RUN_BATCH, 3, **args) == Code.BAD_ARGUMENT
    assert bench.asked == []


def test_other_commands_pass(bench: SimpleNamespace):
    command = Command(name=CommandName.RESET, id=9)
    assert bench.jobs.carry_out(command) is command
