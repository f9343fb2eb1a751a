import io
import json
import pickle
from pathlib import Path

import pytest

from fsw.config import Config
from fsw.errors import EstimatorError
from fsw.messages.commands import BatchRequest
from fsw.service import worker
from fsw.service.blockstore import BlockWriter
from fsw.service.worker import Job, run_job
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


def test_a_job_takes_the_configured_bodies_unless_it_names_others(config: Config):
    blocks = [make_block(k) for k in range(2)]
    report = run_job(config, blocks, request(), lambda *_: True, fake_run)
    assert (report.id, report.state) == (1, "done")
    assert report.result == {"method": "mrnea", "unknown": ["target"], "blocks": [0, 1]}


def test_data_that_do_not_suffice_are_a_failed_job(config: Config):
    def fail(*_args):
        raise EstimatorError("INSUFFICIENT_EXCITATION")

    report = run_job(config, [make_block(0)], request(), lambda *_: True, fail)
    assert (report.state, report.text) == ("failed", "INSUFFICIENT_EXCITATION")
    empty = run_job(config, [], request(), lambda *_: True, fake_run)
    assert empty.text.startswith("NO_DATA")


def test_a_body_without_a_prior_is_a_failed_job(config: Config):
    asked = BatchRequest(id=1, method="fused", unknown=("base",), last_s=None)
    report = run_job(config, [make_block(0)], asked, lambda *_: True, worker.default_batch)
    assert report.state == "failed"
    assert report.text == "bodies.base: missing; unknown lists 'base', which needs a prior"


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
