"""The page of a campaign: its verdict follows the runs, the bad ones are shown, worst first."""

import csv
import json
import re

import numpy as np
import pytest

from evidence.campaign.config import Campaign
from evidence.campaign.page import write_page
from evidence.campaign.summary import ERRORS, summary

SIGMA = np.array([0.1, 0.2, 0.2, 0.2, *[0.5] * 6])
COUNT = 40


def rows(factor: float = 1.0, **changes):
    """Return runs whose errors have `factor` times their sigma."""
    rng = np.random.default_rng(2)
    made = []
    for seed in range(COUNT):
        error = factor * SIGMA * rng.standard_normal(10)
        row = {
            "key": f"{seed}-x",
            "seed": seed,
            "scenario": "target_leo",
            "noise": "data sheet",
            "trajectory": "",
            "status": "OK",
            "traceback": "",
            "error": error.tolist(),
            "sigma": SIGMA.tolist(),
            "bound": SIGMA.tolist(),
            "nees": float(np.sum((error / SIGMA) ** 2)),
            "wall_s": 1.0,
        }
        made.append(row | dict.fromkeys(ERRORS, 0.1) | changes)
    return made


def written(made, folder):
    campaign = Campaign(
        level="sample", seeds={"first": 0, "count": COUNT}, scenarios=["target_leo"]
    )
    paths = write_page(made, summary(made), campaign, folder / "campaign.html")
    assert all(path.stat().st_size for path in paths)
    text = paths[0].read_text(encoding="utf-8")
    inside = re.search(r'type="application/json">(.*?)</script>', text, re.S)
    assert inside is not None
    return text, json.loads(inside[1]), paths


def test_runs_of_their_own_sigma_are_consistent_and_every_one_is_drawn(tmp_path):
    made = rows()
    text, charts, paths = written(made, tmp_path)
    assert f'class="valid">CONSISTENT: {COUNT} of {COUNT} runs valid' in text
    nees, ratios, shape = charts
    assert nees["lines"][0]["y"] == pytest.approx([row["nees"] for row in made])
    assert nees["x"] == list(range(COUNT))
    assert ratios["lines"][3]["y"] == pytest.approx(
        [r["error"][3] / SIGMA[3] for r in made], rel=1e-6
    )
    assert shape["bars"]
    assert all("[" in chart[axis] for chart in charts for axis in ("x_label", "y_label"))
    assert paths[1].read_bytes().startswith(b"\x89PNG")
    with paths[2].open(encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    assert [float(row["error_m_0"]) for row in table] == [row["error"][0] for row in made]


@pytest.mark.parametrize("factor", [0.5, 1.5])
def test_too_large_and_too_small_errors_are_not_consistent(tmp_path, factor):
    text, _, _ = written(rows(factor), tmp_path)
    assert re.search(r'class="">NOT CONSISTENT: mean NEES [\d.]+ not in \[', text)


def test_runs_that_failed_are_not_valid_or_lie_far_off_are_shown_worst_first(tmp_path):
    made = rows()
    lost = {key: made[7][key] for key in ("key", "seed", "scenario", "noise", "trajectory")}
    made[7] = lost | {"status": "FAILED", "traceback": "Traceback\nValueError: <b>no</b>"}
    made[9] |= {"status": "NOT_CONVERGED"}
    made[11]["error"][2] = 9.0 * SIGMA[2]
    made[11]["nees"] = 90.0
    text, charts, _ = written(made, tmp_path)
    assert "NOT CONSISTENT: 1 failed (target_leo, data sheet); 1 not valid" in text
    bad = text[text.index("<h2>Bad runs") : text.index("<h2>target_leo")]
    assert re.findall(r'<tr><td class="number">(\d+)</td>', bad) == ["7", "11", "9"]
    assert "ValueError: &lt;b&gt;no&lt;/b&gt;" in bad
    heads = re.findall("<h2>(.*?)</h2>", text)
    assert heads[:2] == ["Result", "Bad runs"]
    assert heads[-2:] == ["Timing", "Configuration and versions"]
    assert f"all together {COUNT - 1} s" in text
    assert "target.mcy +9.0 sigma" in bad
    assert len(charts[0]["x"]) == COUNT - 2


def test_a_campaign_without_a_valid_run_has_a_page(tmp_path):
    made = [row | {"status": "NOT_CONVERGED"} for row in rows()]
    text, charts, _ = written(made, tmp_path)
    assert f"NOT CONSISTENT: {COUNT} not valid" in text
    assert charts == []
