"""Tables of a report: every row, of which few are in memory."""

import csv
import tracemalloc
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from offline.report.tables import write_tables
from offline.residuals import ChannelResiduals

NODES, CHANNELS = 20_000, 7
BOUND = 30.0  # bytes of memory a row; as Python's numbers it has over 400


def test_a_long_table_is_written_row_by_row(tmp_path) -> None:
    rng = np.random.default_rng(1)
    value, sigma = rng.standard_normal((2, NODES, CHANNELS))
    names = tuple(f"torque.joint{k}" for k in range(CHANNELS))
    residuals = ChannelResiduals(
        names=names,
        units=("N m",) * CHANNELS,
        t_ns=np.arange(NODES) * 50_000_000,
        value=value,
        sigma=sigma,
    )
    result = SimpleNamespace(start_ns=0, unknown=())
    collected = SimpleNamespace(result=result, estimates=(), residuals=residuals, events=())
    tracemalloc.start()
    try:
        write_tables(cast(Any, collected), tmp_path / "own", ["csv"])
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < BOUND * NODES
    with (tmp_path / "own_residuals.csv").open(encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    assert head[:2] == ["t_s", "torque.joint0 [N m]"]
    assert len(rows) == NODES
    assert [float(x) for x in rows[-1]] == [0.05 * (NODES - 1), *value[-1], *sigma[-1]]
