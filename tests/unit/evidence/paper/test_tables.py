"""Cells, orderings, verdicts and the page, on results made up for it."""

import json
import re

import numpy as np
import pytest

from evidence.paper import report, tables
from evidence.paper.cases import ALL, METHODS, PAPER, PAPER_SEED, SYSTEMS
from evidence.paper.printed import BEST, METRICS, PRINTED
from evidence.paper.run import PaperPlan, open_store, quick_plan, units
from hil.world.scenario import ScenarioError

ERROR = {"mrnea": 1e-2, "rda": 1.1e-2, "cm": 5e-2, "ce": 4e-2, "fused": 2e-5}


def made_up(seeds: int = 20) -> dict:
    rng = np.random.default_rng(1)
    results = {}
    for unit in units(PaperPlan(seeds=seeds, few=1, device_seeds=0)):
        if unit.level != "sample":
            continue
        results[unit.key] = {
            method: {
                "status": "OK",
                "nees": 10.0,
                "report": [list(range(1, 11))],
                **{m: ERROR[method] * (1 + 0.2 * rng.standard_normal()) for m in METRICS},
                **{f"expected_{m}": ERROR[method] for m in METRICS},
                **{f"bound_{m}": ERROR[method] for m in METRICS},
            }
            for method in unit.methods
        }
    return results


def test_a_plan_covers_every_cell_with_its_seeds():
    found = units(PaperPlan())
    tables_4_to_7 = [u for u in found if (u.orbit, u.noise, u.acting) == ("leo", PAPER, ALL)]
    for system in SYSTEMS:
        for level, wanted in (("sample", 20), ("device", 20)):
            own = [u for u in tables_4_to_7 if (u.system, u.level) == (system, level)]
            assert len({u.seed for u in own}) == wanted
            assert PAPER_SEED in {u.seed for u in own}
    assert len({u.key for u in found}) == len(found)
    assert not [u for u in units(quick_plan()) if u.level == "device"]


def test_cells_are_medians_and_quartiles_with_the_papers_seed():
    results = made_up()
    table = tables.cells(results)
    wanted = {"orbit": "leo", "system": "base", "noise": PAPER, "acting": ALL}
    (cell,) = tables.pick(table, **wanted, method="rda", metric="mean_position_m")
    values = [
        v["rda"]["mean_position_m"]
        for k, v in results.items()
        if k.startswith(f"sample|leo|base|{PAPER}|{ALL}|")
    ]
    assert (cell.seeds, cell.failed) == (20, 0)
    assert cell.median == pytest.approx(np.median(values))
    assert cell.low == pytest.approx(np.quantile(values, 0.25))
    assert cell.paper_seed == values[0]
    assert cell.printed == PRINTED["mean_position_m"]["rda"]["base"]


def test_orderings_are_claimed_only_where_intervals_are_apart():
    (line, *_) = tables.orderings(tables.cells(made_up()))
    apart, overlap = line.split("intervals overlap:")
    assert "mrnea < cm" in apart
    assert "rda < ce" in apart
    assert "mrnea < rda" in overlap or "rda < mrnea" in overlap


def test_verdicts_hold_the_fused_one_to_a_twentieth():
    judged = tables.verdicts(tables.cells(made_up()), {})
    assert len(judged) == sum(len(best) for best in BEST.values())
    assert all(v["passed"] for v in judged)
    assert min(v["wanted"] for v in judged) == pytest.approx(0.0054 / 20)


def test_what_the_bound_forbids_is_not_called_missed():
    results = made_up()
    for key, values in results.items():
        if key.split("|")[2] == "base":
            for metric in METRICS:
                values["fused"][metric] = values["fused"][f"bound_{metric}"] = 1e-2
    judged = tables.verdicts(tables.cells(results), {})
    base = [v for v in judged if v["name"].startswith("base")]
    assert base
    assert all(v["forbidden"] and not v["passed"] for v in base)
    assert not any(v["forbidden"] for v in judged if v not in base)


def test_the_page_is_self_contained(tmp_path):
    judged = report.write(tmp_path, made_up(3), "abc123")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    inside = re.search(r'type="application/json">(.*?)</script>', page, re.S)
    assert inside is not None
    charts = json.loads(inside[1])
    assert [chart["title"] for chart in charts] == list(SYSTEMS)
    assert charts[0]["lines"][3]["y"][:4] == [
        PRINTED["mean_position_m"][m]["base"] for m in METHODS[:4]
    ]
    assert "http" not in page.replace("http://www.w3.org", "")
    for method in METHODS:
        assert f"base, {method}" in page
    assert "abc123" in page
    document = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert document["verdicts"] == judged
    assert (tmp_path / "report.csv").read_text(encoding="utf-8").count("\n") > 100


def test_the_store_goes_on_where_it_was_cut(tmp_path):
    store = open_store(tmp_path, 100.0)
    store.add("a", {"fused": {"status": "OK"}})
    with (tmp_path / "results.jsonl").open("a", encoding="utf-8") as file:
        file.write('["b", {"fus')
    again = open_store(tmp_path, 100.0)
    assert list(again.rows) == ["a"]
    with pytest.raises(ScenarioError, match="other settings"):
        open_store(tmp_path, 500.0)
