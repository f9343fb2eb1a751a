"""Configurations of described joints and of a feed on the bench, which encodes frames itself."""

import pytest

from hil.judge import judgement
from hil.run import bench
from hil.run.own_flight import own_world
from tests.support.own_wires import WIRES, own_wires
from tests.support.short_cases import NoMeter, short

CHI2_10_999 = 29.6
RATE_HZ = 100.0


@pytest.mark.parametrize("kind", WIRES)
def test_the_target_is_found_by_ones_own_wires_and_nothing_is_lost(tmp_path, kind):
    path = own_wires(tmp_path, kind, RATE_HZ)
    world = short(tmp_path, 7, RATE_HZ)
    scenario, own = own_world(world, path, None, 1, tmp_path / "run")
    setup = bench.prepare(scenario, 1, tmp_path / "run", own=own)
    recorded = bench.run_virtual(setup, NoMeter(), record=False)
    outcome = judgement.judge(setup, judgement.make_case(setup), recorded)
    assert outcome["valid"], outcome["reason"]
    assert outcome["nees"] < CHI2_10_999
    counts = recorded.status["samples"]["left"]
    assert (counts["rejected"], counts["lost"]) == (0, 0), counts
    expected = RATE_HZ * setup.total_s * len(setup.config.joints)
    assert counts["accepted"] == pytest.approx(expected, rel=0.01)
    assert not [event for event in recorded.events if event.severity in ("medium", "high")]
    assert outcome["exact"]["valid"], outcome["exact"]["reason"]
