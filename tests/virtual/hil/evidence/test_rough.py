"""The acceptance in a rough world, in its short form: one seed of the command's own code."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from scipy.stats import chi2

from hil.evidence.rough.case import Case, made, work
from hil.evidence.rough.command import rough


@pytest.mark.parametrize("unknown", ["target", "both"])
def test_declared_it_is_valid_and_honest(unknown: str) -> None:
    (row,) = work(Case(unknown, "declared", 0)).values()
    assert row["valid"], row["reason"]
    assert row["wrong"] == 0
    assert row["nees"] < chi2.ppf(0.999, row["dof"])


def test_undeclared_it_is_never_valid_and_wrong_and_rows_are_kept(tmp_path: Path) -> None:
    (summary,) = rough(["target"], ["undeclared"], [0], 1, tmp_path)
    assert summary["wrong"] == 0
    assert summary["passed"]
    assert summary["valid"] == 0
    (line,) = (tmp_path / "results.jsonl").read_text(encoding="utf-8").splitlines()
    assert json.loads(line)[0] == "target undeclared 0"
    assert rough(["target"], ["undeclared"], [0], 1, tmp_path) == [summary]


def test_the_flight_side_knows_nothing_of_the_rough_world(tmp_path: Path) -> None:
    """Its links and base are off, its declared noise is that of white samples."""
    config, blocks = made(Case("target", "declared", 1), tmp_path, 3)
    assert len(blocks) == 3
    assert config.robot.links_sigma_ratio == pytest.approx(0.0321, abs=1e-4)
    off = abs(config.bodies["base"].mass_kg / 1000.0 - 1.0)
    assert 0.01 <= off <= 0.05
