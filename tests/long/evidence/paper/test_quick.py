"""The study's code end to end on one system, one seed."""

from dataclasses import replace

import pytest
from rich.console import Console

from evidence.paper import report, run
from evidence.paper.cases import ALL, PAPER


@pytest.mark.slow
def test_the_target_alone_end_to_end(tmp_path, monkeypatch):
    """Fused within a twentieth of the best printed figures; nine tenths of the bias removed."""
    plan = replace(run.quick_plan(), systems=("target",))
    wanted = [u for u in run.units(plan) if (u.orbit, u.noise, u.acting) == ("leo", PAPER, ALL)]
    bias = [u for u in run.units(plan) if u.level == run.BIAS]
    monkeypatch.setattr(run, "units", lambda _plan: wanted + bias)
    results = run.complete(plan, run.open_store(tmp_path, plan.rate_hz), 1, Console(quiet=True))
    judged = report.write(tmp_path, results, "test")
    assert {v["name"].split(":")[0] for v in judged} >= {"target, fused"}
    for verdict in judged:
        assert verdict["passed"], verdict
