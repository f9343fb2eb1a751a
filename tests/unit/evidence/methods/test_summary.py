"""What the report says beside its tables: which commit, and which method stands first."""

from dataclasses import replace

import numpy as np

from evidence.methods.cases import SAMPLE, Key, StudyRecord
from evidence.methods.statistics import figures
from evidence.methods.summary import SummaryRow, orderings, provenance


def record(method, seed, commit, size=1.0, sensors="good IMU"):
    key = Key(level=SAMPLE, case="target", sensors=sensors, method=method, seed=seed)
    error = size * np.random.default_rng(seed).standard_normal(10)
    return StudyRecord(
        key=key, status="OK", error=error, sigma=np.ones(10), nees=10.0, iterations=1, commit=commit
    )


def row(method, size, sensors):
    own = [record(method, seed, "a", size, sensors) for seed in range(12)]
    bounds = [np.eye(10)] * len(own)
    return SummaryRow(
        level=SAMPLE,
        case="target",
        sensors=sensors,
        method=method,
        figures=figures(own, bounds, bounds, {"target mass": slice(0, 10)}),
        bias_note="",
    )


def test_every_result_is_counted_under_its_commit():
    records = [record("rda", 0, "aaa"), record("rda", 1, "bbb"), record("fused", 0, "bbb")]
    records.append(replace(record("rda", 2, "bbb")))
    lines = provenance({r.key: r for r in records})
    assert "  sample, rda: aaa 1, bbb 2" in lines
    assert "  sample, fused: bbb 1" in lines


def test_the_swap_of_mrnea_and_rda_is_named():
    table = [
        row("mrnea ols", 1.0, "good IMU"),
        row("rda", 2.0, "good IMU"),
        row("mrnea ols", 3.0, "poor IMU"),
        row("rda", 2.0, "poor IMU"),
    ]
    line = orderings(table)[-1]
    assert "mrnea ols first with good IMU; rda first with poor IMU" in line
