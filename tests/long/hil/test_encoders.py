"""Encoders of 14 to 18 bits at 100 to 1000 Hz: nearly the sigma of their samples, without a key."""

from dataclasses import replace
from typing import Any

import pytest
from scipy.stats import chi2

from hil.judge import judgement
from hil.run import bench
from hil.world.scenario import load
from tests.support.short_cases import NoMeter

MOST = {24: 1.05, 20: 1.05, 18: 1.05, 16: 1.10, 14: 1.10}  # mass sigma over the true bound
SURE = 0.999


@pytest.mark.parametrize(
    ("name", "bits", "rate_hz"),
    [
        ("target_leo", 14, 500.0),
        ("target_leo", 16, 100.0),
        ("target_leo", 18, 1000.0),
        ("base", 14, 100.0),
        ("both", 18, 500.0),
        ("both", 16, 100.0),
    ],
)
def test_a_coarse_encoder_costs_little(tmp_path, name, bits, rate_hz):
    scenario = load(name)
    flight = scenario.flight
    scenario = replace(
        scenario,
        sensors=scenario.sensors | {"joints": scenario.sensors["joints"] | {"encoder_bits": bits}},
        flight=flight | {"bus": flight["bus"] | {"rate_hz": rate_hz}, "tick_rate_hz": rate_hz},
    )
    setup = bench.prepare(scenario, 6, tmp_path, real_time=False)
    recorded = bench.run_virtual(setup, NoMeter(), record=False)
    outcome: dict[str, Any] = judgement.judge(setup, judgement.make_case(setup), recorded)
    ratios = outcome["mass_sigma_to_true_crb_ratio"]
    assert outcome["valid"], outcome["reason"]
    assert outcome["nees"] < chi2.ppf(SURE, 10 * len(ratios))
    assert max(ratios.values()) < MOST[bits], ratios
