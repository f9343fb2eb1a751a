"""A whole flight with an inertial unit that sends increments: its estimate is consistent."""

import json
import subprocess
import sys

import pytest

SEEDS = 1  # `hil seeds` flies more


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_unit_that_sends_increments_flies_as_well_as_one_that_sends_rates():
    words = [sys.executable, "-m", "hil", "seeds", "target_leo", "--count", str(SEEDS), "--json"]
    words += ["--set", "sensors.imu.device=kvh"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    total = json.loads(done.stdout)["summary"]
    low, high = total["nees_band_99"]
    assert (total["valid"], total["ever_valid_and_wrong"]) == (SEEDS, 0)
    assert low < total["mean_nees"] < high
    assert (total["lost"], total["late"], total["rejected"]) == (0, 0, 0)
