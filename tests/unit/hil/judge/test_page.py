"""The page of a run: verdict first, truth beside estimate, errors over time with their band."""

import csv
import json
import re

import numpy as np
import pytest

from hil.judge.page import save
from hil.world.inertia import LABELS
from hil.world.scenario import mapping_from
from offline.report.view import Section
from tests.support.stories import TRUTH, story

REST = [Section(title="Configuration", source="name: </script>flight\n")]


def outcome(bodies, **changes):
    tool = dict.fromkeys(
        ("mean_position_m", "max_position_m", "mean_angle_rad", "max_angle_rad"), 1e-5
    )
    told = {body: mapping_from(TRUTH) for body in bodies}
    values = {
        "scenario": "target_leo",
        "seed": 3,
        "method": "fused",
        "unknown": list(bodies),
        "valid": True,
        "reason": "",
        "nees": 9.4,
        "dof": 10 * len(bodies),
        "mass_sigma_to_crb_ratio": dict.fromkeys(bodies, 1.1),
        "mass_sigma_to_true_crb_ratio": dict.fromkeys(bodies, 1.04),
        "prior": {body: mapping_from(TRUTH * 1.5) for body in bodies},
        "samples": {"arm": {"received": 7, "lost": 1, "late": 0, "rejected": 0}},
        "windows": {"closed": 8},
        "slips": 0,
        "simulated_s": 65.0,
        "wall_s": 3.0,
        "blocks": 8,
        "gated": 0,
    }
    values |= dict.fromkeys(("truth", "estimate", "sigma", "crb"), told)
    return (
        values | dict.fromkeys(("ee_error", "ee_error_prior", "ee_error_expected"), tool) | changes
    )


def charts_of(path):
    text = path.read_text(encoding="utf-8")
    inside = re.search(r'type="application/json">(.*?)</script>', text, re.S)
    assert inside is not None
    return text, json.loads(inside[1])


@pytest.mark.parametrize("bodies", [("target",), ("base", "target")])
def test_errors_from_the_truth_are_drawn_with_three_sigma_and_units(tmp_path, bodies):
    told = story(bodies, 8)
    save(told, outcome(bodies), REST, tmp_path / "report.html")
    text, charts = charts_of(tmp_path / "report.html")
    assert f'class="valid">VALID; NEES 9.4 for {10 * len(bodies)} parameters' in text
    assert text.index("VALID") < text.index("<h2>")
    assert "&lt;/script&gt;flight" in text
    errors = [chart for chart in charts if "minus truth" in chart["title"]]
    assert len(errors) == 10 * len(bodies)  # a chart per quantity
    mass = errors[0]["lines"][0]
    found = [point.reports[bodies[0]][0] - TRUTH[0] for point in told.points]
    assert mass["y"] == pytest.approx(found, rel=1e-6)
    reach = [3.0 * point.sigmas[bodies[0]][0] for point in told.points]
    band = np.array(mass["high"]) - np.array(mass["low"])
    assert band == pytest.approx(2.0 * np.array(reach), rel=1e-5)
    assert all("[" in chart[axis] for chart in charts for axis in ("x_label", "y_label"))
    with (tmp_path / "report.csv").open(encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    assert [float(row["target_cz"]) for row in table] == [
        p.reports["target"][3] for p in told.points
    ]
    assert float(table[0]["target_Izz_truth"]) == TRUTH[LABELS.index("Izz")]


def test_a_run_that_is_not_valid_or_has_no_estimate_says_so(tmp_path):
    told = outcome(("target",), valid=False, reason="NO_ESTIMATE")
    save(story(("target",), 0), told, REST, tmp_path / "report.html")
    text, charts = charts_of(tmp_path / "report.html")
    assert 'class="">NOT VALID: NO_ESTIMATE; NEES' in text
    assert not [chart for chart in charts if "minus truth" in chart["title"]]
