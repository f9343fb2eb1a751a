"""The whole motion on a live feed: what is found lies within its own uncertainty."""

import json
import subprocess
import sys

import pytest

SEEDS = 1  # `hil seeds` flies more
OWN_CLOCK = "clock: device, clock_error_ppm: 50, clock_offset_s: 123456"
CASES = {
    "target_leo": "{rate_hz: 500, encoding: json}",
    "target_leo_1khz": f"{{rate_hz: 1000, {OWN_CLOCK}}}",
}


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("scenario", "feed"), CASES.items())
def test_every_seed_is_valid_with_its_nees_in_the_band_and_nothing_lost(scenario, feed):
    words = [sys.executable, "-m", "hil", "seeds", scenario, "--count", str(SEEDS), "--json"]
    words += ["--set", f"sensors.joints.feed={feed}"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    total = json.loads(done.stdout)["summary"]
    low, high = total["nees_band_99"]
    assert (total["valid"], total["ever_valid_and_wrong"]) == (SEEDS, 0)
    assert low < total["mean_nees"] < high
    assert total["bodies"]["target"]["within_3_sigma"] == SEEDS
    assert (total["lost"], total["late"], total["rejected"]) == (0, 0, 0)
