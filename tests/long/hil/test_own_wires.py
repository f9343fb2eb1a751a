"""Configurations of described joints and of a feed on the bench in real time."""

from pathlib import Path
from typing import Any

import pytest

from hil.judge import judgement
from hil.run import bench
from hil.run.own_flight import own_world
from tests.support.own_wires import own_wires
from tests.support.short_cases import NoMeter, short

CHI2_10_999 = 29.6
RATE_HZ = 100.0


def flown(tmp_path: Path, kind: str) -> dict[str, Any]:
    path = own_wires(tmp_path, kind, RATE_HZ)
    scenario, own = own_world(short(tmp_path, 7, RATE_HZ), path, None, 1, tmp_path / "run")
    setup = bench.prepare(scenario, 1, tmp_path / "run", real_time=True, own=own)
    recorded = bench.run_live(setup, NoMeter())
    counts = recorded.status["samples"]["left"]
    assert counts["accepted"] > 0.95 * RATE_HZ * setup.total_s * len(setup.config.joints), counts
    return judgement.judge(setup, judgement.make_case(setup), recorded)


@pytest.mark.parametrize("kind", ["feed", "keys"])
def test_the_target_is_found_by_samples_with_a_time_in_real_time(tmp_path, kind):
    outcome = flown(tmp_path, kind)
    assert outcome["valid"], outcome["reason"]
    assert outcome["nees"] < CHI2_10_999


@pytest.mark.parametrize("kind", ["dbc", "eds"])
def test_frames_that_this_machine_holds_for_a_period_give_nothing_wrong(tmp_path, kind):
    outcome = flown(tmp_path, kind)
    assert outcome["outputs"]["wrong"] == 0
    assert outcome["nees"] < CHI2_10_999 or not outcome["valid"]
