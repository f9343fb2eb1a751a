"""Basilisk flies what MuJoCo flies, and the daemon finds the target from its bytes."""

import pytest

from hil.basilisk.command import ENVIRONMENT, fly
from hil.judge import judgement
from hil.run import bench
from tests.support.short_cases import NoMeter, short

CHI2_10_999 = 29.6  # 99.9 % bound of chi-squared with 10 degrees of freedom

pytestmark = pytest.mark.skipif(
    not ENVIRONMENT.exists(),
    reason="needs Basilisk in an environment of its own: sh tests/setup --all",
)


def test_the_target_is_found_from_the_bytes_of_the_second_truth(tmp_path):
    scenario = short(tmp_path, points=6)
    flown = fly(scenario, ENVIRONMENT)
    assert not flown.beyond, flown.apart
    flown.truth.save(tmp_path / "truth.npz", scenario.name)
    setup = bench.prepare(scenario, 1, tmp_path, truth=tmp_path / "truth.npz")
    recorded = bench.run_virtual(setup, NoMeter(), record=False)
    outcome = judgement.judge(setup, judgement.make_case(setup), recorded)
    assert outcome["valid"], outcome["reason"]
    assert outcome["nees"] < CHI2_10_999


@pytest.mark.parametrize("name", ["wheels_leo", "base_slosh", "panel_leo", "two_arms"])
def test_wheels_liquid_panel_and_two_arms_move_alike_in_both_engines(tmp_path, name):
    flown = fly(short(tmp_path, name=name, points=1), ENVIRONMENT)
    assert not flown.beyond, flown.apart
