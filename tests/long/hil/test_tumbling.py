"""Base and target tumble: found from device bytes, undeclared, and beyond the unit's range."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsw.drivers.sources import ImuSource
from fsw.drivers.wire import ByteChunk
from fsw.messages.findings import Fault
from hil.devices.imu import Imu
from hil.devices.truth_clock import ClampedHistory, TruthClock
from hil.judge import judgement
from hil.run import bench
from hil.world.scenario import Scenario
from hil.world.sensor_config import SensorConfig
from hil.world.truth import simulate
from tests.support.short_cases import NoMeter, short
from tests.support.truth_cases import stand_in

CHI2_10_999 = 29.6  # 99.9 % bound of chi-squared with 10 degrees of freedom
CHI2_20_999 = 45.3


def judged(folder: Path, scenario: Scenario) -> tuple[dict[str, Any], Any]:
    setup = bench.prepare(scenario, 1, folder)
    recorded = bench.run_virtual(setup, NoMeter(), record=False)
    return judgement.judge(setup, judgement.make_case(setup), recorded), recorded


@pytest.mark.parametrize(
    ("unknown", "bound"), [(("target",), CHI2_10_999), (("base", "target"), CHI2_20_999)], ids=str
)
def test_what_tumbles_is_found_with_its_momentum(
    tmp_path: Path, unknown: tuple[str, ...], bound: float
) -> None:
    scenario = replace(short(tmp_path, name="tumbling_target"), unknown=unknown)
    outcome, recorded = judged(tmp_path, scenario)
    assert outcome["valid"], outcome["reason"]
    assert outcome["nees"] < bound
    final = recorded.estimates[-1]
    found = [final.mean[k] for k, name in enumerate(final.names) if "momentum" in name]
    assert 55.0 < np.linalg.norm(found) < 67.0  # N m s; 61.2 in the truth
    codes = {event.code for event in recorded.events}
    assert not codes & {"CHANGE_DETECTED", "ESTIMATOR_RESET", "PRIOR_CONFLICT", "TRACKER_JUMP"}


def test_tumbling_that_is_not_declared_is_never_confidently_wrong(tmp_path: Path) -> None:
    scenario = short(tmp_path, name="tumbling_target")
    scenario = replace(scenario, flight=scenario.flight | {"estimator": {}})
    outcome, recorded = judged(tmp_path, scenario)
    assert not outcome["valid"]
    assert not any(estimate.valid for estimate in recorded.estimates)


@pytest.mark.parametrize(("rate_rad_s", "is_used"), [(6.9, True), (8.0, False), (12.0, False)])
def test_a_rate_beyond_the_unit_s_range_is_refused_and_reported(
    rate_rad_s: float, is_used: bool, tmp_path: Path
) -> None:
    """400 deg/s are 6.98 rad/s; the wire ends at 512 deg/s, 8.94 rad/s, and saturates there."""
    case = stand_in(None)
    truth = simulate(case.robot, case.spline, -0.5, 0.0, w_NB_B_rad_s=(0.0, 0.0, rate_rad_s))
    held = replace(truth, w_B=0.0 * truth.w_B + [0.0, 0.0, rate_rad_s], wd_B=0.0 * truth.wd_B)
    setup = bench.prepare(short(tmp_path), 1, tmp_path)
    sensors = SensorConfig.from_dict(setup.scenario.sensors).imu
    assert sensors is not None
    clock = TruthClock(start_delay_s=0.4)
    clock.start(10**12)
    unit = Imu(replace(sensors, acc_range_g=80), ClampedHistory(held), clock, 1, 10**12)
    source = ImuSource(setup.config.imu.model_copy(update={"acc_range_g": 80}))
    chunks = [ByteChunk(t_ns, data) for t_ns, data in unit.take(10**12 + 300_000_000)]
    samples = sum(len(source.feed([chunk])) for chunk in chunks)
    counters, found = source.counters, [finding.fault for finding in source.findings()]
    assert counters["received"] > 30
    if is_used:
        assert counters["rejected"] == 0
        assert samples >= counters["received"] - 1
    else:
        assert samples == 0
        assert counters["reject_range"] == counters["received"]
        assert Fault.IMU_RANGE in found
