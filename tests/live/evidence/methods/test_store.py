"""Results survive a crash, are not run twice and are not mixed with another study's."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from evidence.methods.cases import DEVICE, SAMPLE, Key, StudyRecord
from evidence.methods.records import open_store, records, rows
from evidence.methods.run import Plan as StudyPlan
from evidence.methods.run import missing, wanted
from evidence.store import Store
from hil.errors import SETTINGS
from hil.world.scenario import ScenarioError


def record(seed, method="fused", error=True):
    key = Key(level=SAMPLE, case="base", sensors="data sheet", method=method, seed=seed)
    values = np.linspace(-1, 1, 10) * np.pi if error else None
    nees = 9.5 if error else float("inf")
    return StudyRecord(key=key, status="OK", error=values, sigma=values, nees=nees, iterations=3)


def add(store: Store, *results: StudyRecord) -> None:
    for key, row in rows(results).items():
        store.add(key, row)


def test_what_is_read_is_what_was_written(tmp_path):
    add(open_store(tmp_path), record(0), record(1, error=False))
    found = records(open_store(tmp_path))
    assert list(found) == [record(0).key, record(1).key]
    np.testing.assert_array_equal(found[record(0).key].error, record(0).error)
    assert found[record(1).key].error is None
    assert found[record(1).key].nees == float("inf")


def test_results_name_the_commit_of_their_code(tmp_path):
    add(open_store(tmp_path), record(0))
    here = Path(__file__).parent
    asked = ("git", "-C", str(here), "rev-parse", "--short", "HEAD")
    ran = subprocess.run(asked, capture_output=True, text=True, check=False)
    found = records(open_store(tmp_path))[record(0).key].commit
    expected = ran.stdout.strip() if ran.returncode == 0 else "unknown"
    assert found.removesuffix("+").startswith(expected)


def test_results_of_other_settings_are_refused(tmp_path):
    open_store(tmp_path)
    path = tmp_path / SETTINGS
    path.write_text(json.dumps(json.loads(path.read_text()) | {"rate_hz": 50.0}))
    with pytest.raises(ScenarioError, match="other settings"):
        open_store(tmp_path)


def test_only_what_is_missing_is_run():
    plan = StudyPlan(sample_seeds=2, device_seeds=1, cases=("base",), sensor_sets=("data sheet",))
    units = wanted(plan)
    first = next(unit for unit in units if unit.level == SAMPLE)
    rest = missing(units, {key for key in first.keys if key.method != "rda"})
    assert [unit.methods for unit in rest if unit.seed == 0 and unit.level == SAMPLE] == [("rda",)]
    assert sum(unit.level == DEVICE for unit in rest) == 3
    assert missing(units, {key for unit in units for key in unit.keys}) == []
