"""An arm that is on no CAN bus: a live feed in virtual time, recorded and replayed."""

from dataclasses import replace

import pytest

from fsw.exchange.recording import contents
from fsw.exchange.status import estimate_summary
from hil.run import bench
from offline.replay import replay
from tests.support.short_cases import NoMeter, short

FEED = {
    "rate_hz": 400.0,
    "encoding": "json",
    "clock": "unix",
    "clock_offset_s": 1.7e9,
    "clock_error_ppm": 50.0,
    "loss_ratio": 0.01,
    "key_hex": bytes(range(32)).hex(),
}


def test_a_flight_on_a_keyed_feed_with_losses_is_replayed_to_the_bit(tmp_path):
    scenario = short(tmp_path, points=4, hurry=2.0)
    joints = scenario.sensors["joints"] | {"feed": FEED}
    scenario = replace(scenario, sensors=scenario.sensors | {"joints": joints})
    setup = bench.prepare(scenario, 1, tmp_path)
    flown = bench.run_virtual(setup, NoMeter(), record=True)
    recording = tmp_path / "recording.mcap"
    assert "/serial/arm" in contents(recording).topics
    again = replay(recording, setup.config)
    assert estimate_summary(again.estimate) == estimate_summary(flown.estimates[-1])
    counts = flown.status["samples"]["arm"]
    sent = 7 * FEED["rate_hz"] * setup.total_s
    assert counts["accepted"] + counts["lost"] == pytest.approx(sent, abs=7 * 3)
    assert 0.005 < counts["lost"] / sent < 0.02
    assert (counts["rejected"], counts["late"]) == (0, 0)
    assert {event.code for event in flown.events} <= {"JOINT_LOST", "RECOVERED", "STOPPED"}
    assert {key: again.status["samples"]["arm"][key] for key in counts} == counts
