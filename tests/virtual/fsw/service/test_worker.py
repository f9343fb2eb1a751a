import io
import json
import pickle
from pathlib import Path

import pytest

from fsw.config import Config
from fsw.messages.commands import BatchRequest
from fsw.messages.errors import EstimatorError
from fsw.service import worker
from fsw.service.blockstore import BlockWriter
from fsw.service.worker import InlineJobs, Job
from tests.conftest import ArmProject
from tests.support.loop_cases import arm_config, make_block


def request(number: int = 1, last_s: float | None = None) -> BatchRequest:
    return BatchRequest(id=number, method="mrnea", unknown=(), last_s=last_s)


def fake_run(config, blocks, method, unknown, progress):  # noqa: ARG001
    progress(0.5, "half")
    return {"method": method, "unknown": list(unknown), "blocks": [b.index for b in blocks]}


@pytest.fixture
def config(arm: ArmProject) -> Config:
    return arm_config(arm)


def inline(config: Config, run=fake_run) -> InlineJobs:
    jobs = InlineJobs(config, 2.0, run)
    for k in range(5):
        jobs.store(make_block(k))
    return jobs


def test_an_inline_result_arrives_after_the_virtual_delay(config: Config):
    jobs = inline(config)
    jobs.submit(request(last_s=1.0), 10**9)
    assert jobs.poll(3 * 10**9 - 1) == []
    (report,) = jobs.poll(3 * 10**9)
    assert (report.id, report.state) == (1, "done")
    assert report.result == {"method": "mrnea", "unknown": ["target"], "blocks": [3, 4]}
    assert jobs.poll(10**12) == []


def test_an_aborted_inline_job_gives_no_result(config: Config):
    jobs = inline(config)
    jobs.submit(request(), 0)
    jobs.abort()
    (report,) = jobs.poll(1)
    assert (report.state, report.result) == ("aborted", None)


def test_what_the_data_cannot_give_is_a_failed_job(config: Config):
    def fail(*_args):
        raise EstimatorError("INSUFFICIENT_EXCITATION")

    jobs = inline(config, fail)
    jobs.submit(request(), 0)
    (report,) = jobs.poll(2 * 10**9)
    assert (report.state, report.text) == ("failed", "INSUFFICIENT_EXCITATION")
    empty = InlineJobs(config, 0.0, fake_run)
    empty.submit(request(), 0)
    assert empty.poll(0)[0].text.startswith("NO_DATA")


def test_the_process_tells_progress_then_the_result(
    config: Config, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(worker, "default_batch", fake_run)
    store = BlockWriter(tmp_path / "blocks")
    store.append(make_block(4))
    job = Job(config=config, request=request(9), blocks=tmp_path / "blocks")
    out = io.StringIO()
    assert worker.main(io.BytesIO(pickle.dumps(job)), out) == 0
    lines = [json.loads(line) for line in out.getvalue().splitlines()]
    assert [(line["state"], line["progress"]) for line in lines] == [
        ("running", 0.5),
        ("done", 1.0),
    ]
    assert lines[1]["result"]["blocks"] == [4]
