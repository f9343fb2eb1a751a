"""RUN_PLAN from the service's end: a real worker, a posterior, a motion that others can fly."""

import io
import json
import os
import pickle
import select
import signal
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evidence.excitation import cases
from fsw.config import Config
from fsw.errors import CommandError
from fsw.messages.commands import Code, Command, CommandName
from fsw.service import worker
from fsw.service.batch_jobs import BatchJobs
from fsw.service.worker import Job
from hil.world.spline import JointSpline
from planner.subject import build_subject
from tests.support.excitation_cases import LIMITS_FILE
from tests.support.loop_cases import make_estimate

ASKED = {"duration_s": 10.0, "starts": 2, "seed": 3}
PATIENCE_S = 280.0


def flight(folder: Path, jobs: int = 1) -> Config:
    document = cases.config("target").model_dump()
    document["excitation"] = {"limits": str(LIMITS_FILE), "jobs": jobs}
    document["service"]["state_directory"] = folder
    return Config.model_validate(document)


def known(config: Config, share: float = 0.1):
    """An estimate with a share of the prior's covariance."""
    own = build_subject(config)
    names = own.problem.names[own.problem.bodies]
    covariance = share * own.state_covariance[:10, :10]
    return replace(make_estimate(0), names=names, mean=own.x, covariance=covariance, reasons=())


def jobs_of(config: Config, folder: Path) -> tuple[BatchJobs, list]:
    told: list = []
    jobs = BatchJobs(config, folder / "blocks", lambda *event: told.append(event))
    jobs.estimate = known(config)
    return jobs, told


def ended(jobs: BatchJobs) -> list:
    """Wait until the job has ended; return all that it reported."""
    reports = []
    deadline_s = time.monotonic() + PATIENCE_S
    process = jobs._process
    while jobs.is_running and time.monotonic() < deadline_s:
        reports += jobs.poll()
        with suppress(PermissionError, ProcessLookupError):  # other tests leave nice 19 no time
            os.setpriority(os.PRIO_PROCESS, process.pid, 0)
        time.sleep(0.02)
    jobs.close()
    return reports


@pytest.mark.timeout(600)
def test_a_motion_from_the_estimate_is_planned_beside_the_service(tmp_path):
    jobs, told = jobs_of(flight(tmp_path), tmp_path)
    one = Command(name=CommandName.RUN_PLAN, id=5, args=ASKED | {"starts": 1})
    assert jobs.carry_out(one) is None
    with pytest.raises(CommandError) as busy:
        jobs.carry_out(Command(name=CommandName.RUN_PLAN, id=6, args=ASKED))
    assert busy.value.code == Code.JOB_RUNNING
    reports = ended(jobs)
    assert (reports[-1].state, reports[-1].text) == ("done", "plan_0001.yaml")
    ratios = [report.progress for report in reports]
    assert ratios == sorted(ratios)
    assert 0.0 < ratios[len(ratios) // 2] < 1.0
    path = tmp_path / "files" / "plans" / "plan_0001.yaml"
    assert JointSpline.load(path).duration_s == ASKED["duration_s"]
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    assert [event[1] for event in told] == ["PLAN_WRITTEN", "BATCH_DONE"]
    assert told[0][2].startswith("plans/plan_0001.yaml: target: sigma mass_kg ")
    before, _, after = told[0][2].split("mass_kg ")[1].split(",")[0].split(" ")
    assert float(after) < float(before)
    with pytest.raises(CommandError) as none:  # a motion is no result to adopt
        jobs.carry_out(Command(name=CommandName.ADOPT, id=7))
    assert none.value.code == Code.NO_RESULT


@pytest.mark.timeout(600)
def test_an_ended_job_leaves_no_process_and_no_file(tmp_path):
    jobs, told = jobs_of(flight(tmp_path, 2), tmp_path)
    before = signal.signal(signal.SIGTERM, signal.SIG_IGN)  # as the service has it
    jobs.carry_out(Command(name=CommandName.RUN_PLAN, id=5, args=ASKED))
    signal.signal(signal.SIGTERM, before)
    process = jobs._process
    assert process is not None
    assert os.getpriority(os.PRIO_PROCESS, process.pid) in (0, worker.NICE)  # 0: not up yet
    children: list[int] = []
    deadline_s = time.monotonic() + PATIENCE_S
    while len(children) < 2 and time.monotonic() < deadline_s:
        jobs.poll()
        listed = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        children = [int(pid) for pid in listed]
        time.sleep(0.02)
    assert os.getpriority(os.PRIO_PROCESS, children[0]) == worker.NICE
    watched = [os.pidfd_open(pid) for pid in children]
    jobs.carry_out(Command(name=CommandName.ABORT_BATCH, id=6))
    assert ended(jobs)[-1].state == "aborted"
    for descriptor in watched:
        assert select.select([descriptor], [], [], PATIENCE_S)[0]  # readable once it has ended
        os.close(descriptor)
    assert [event[1] for event in told] == ["BATCH_ABORTED"]
    assert not (tmp_path / "files" / "plans").exists()


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        ({"estimate": None}, Code.NO_RESULT, "no estimate"),
        ({"reasons": ("MODEL_MISMATCH",)}, Code.NO_RESULT, "MODEL_MISMATCH"),
        ({"excitation": None}, Code.NOT_SUPPORTED, "excitation.limits: missing"),
    ],
)
def test_what_cannot_be_planned_is_refused_with_one_reason(tmp_path, change, code, words):
    jobs, _ = jobs_of(flight(tmp_path), tmp_path)
    if "reasons" in change:
        jobs.estimate = replace(jobs.estimate, reasons=change["reasons"])
    elif "estimate" in change:
        jobs.estimate = None
    else:
        jobs.config = jobs.config.model_copy(update=change)
    with pytest.raises(CommandError, match=words) as refused:
        jobs.carry_out(Command(name=CommandName.RUN_PLAN, id=5, args=ASKED))
    assert refused.value.code == code
    assert not jobs.is_running


@pytest.mark.parametrize(
    ("estimate", "words"),
    [
        ({"covariance": np.zeros((10, 10))}, "positive definite"),
        ({"mean": np.full(10, np.nan)}, "not finite"),
        ({"names": ("x",) * 10}, "must be a result"),
        ({}, "cannot be read"),
    ],
)
def test_a_job_that_fails_says_why(tmp_path, estimate, words):
    config = flight(tmp_path)
    jobs, _ = jobs_of(config, tmp_path)
    jobs.estimate = replace(jobs.estimate, **estimate)
    request = jobs._plan(Command(name=CommandName.RUN_PLAN, id=5, args=ASKED))
    if not estimate:
        gone = config.excitation.model_copy(update={"limits": tmp_path / "gone.yaml"})
        config = config.model_copy(update={"excitation": gone})
    out = io.StringIO()
    job = Job(config=config, request=request, blocks=tmp_path / "blocks")
    assert worker.main(io.BytesIO(pickle.dumps(job)), out) == 1
    last = json.loads(out.getvalue().splitlines()[-1])
    assert last["state"] == "failed"
    assert words in last["text"]
