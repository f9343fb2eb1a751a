"""A controller that chatters for 40 s until torques leave the range of their sensors."""

from dataclasses import replace

from hil.judge import judgement
from hil.run import bench
from hil.world.scenario import load
from hil.world.sudden import Chatter
from tests.support.short_cases import NoMeter

CHI2_10_999 = 29.6


def test_torques_beyond_their_range_give_nothing_wrong(tmp_path):
    scenario = replace(load("target_leo"), sudden=Chatter())
    setup = bench.prepare(scenario, 1, tmp_path / "run")
    recorded = bench.run_virtual(setup, NoMeter(), record=False)
    outcome = judgement.judge(setup, judgement.make_case(setup), recorded)
    assert outcome["events"]["TORQUE_RANGE"] > 0
    assert outcome["outputs"]["wrong"] == 0
    assert outcome["nees"] < CHI2_10_999
    assert outcome["valid"], outcome["reason"]
    ratio = outcome["sigma"]["target"]["mass_kg"] / outcome["true_crb"]["target"]["mass_kg"]
    assert ratio < 10.0, "the windows before and after the chatter count in full"
