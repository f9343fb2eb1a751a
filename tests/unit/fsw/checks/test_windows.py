"""Windows that hold a mode's swing, and samples that come before they close."""

import numpy as np
import pytest

from fsw.checks.configuration import validate
from fsw.config import load
from fsw.estimators.conditioning.polynomial import NodeFit, gauss_nodes
from fsw.estimators.model.modes import NODES_PER_PERIOD
from offline.describe import describe
from tests.support.check_cases import assert_named, fault
from tests.unit.fsw.checks.test_actuators import wheel
from tests.unit.fsw.checks.test_base_parts import tank


def missed(nodes: int, periods: float) -> float:
    """Return what a window's values at its nodes miss of a swing, as a share of it, rms."""
    t = np.linspace(-0.5, 0.5, 401)
    fit = NodeFit(t, 0.5, nodes - 1, nodes)
    phases = 2.0 * np.pi * periods * t[:, None] + np.linspace(0.0, np.pi, 9)
    at_nodes = 0.5 * 2.0 * np.pi * periods * gauss_nodes(nodes)[:, None] + np.linspace(0, np.pi, 9)
    error = fit.operator(0) @ fit.coefficients(np.cos(phases)) - np.cos(at_nodes)
    return float(np.sqrt(2.0 * np.mean(error**2, axis=0).max()))


@pytest.mark.parametrize("nodes", range(2, 9))
def test_up_to_the_bound_a_window_misses_about_a_tenth_of_a_swing_and_soon_a_third(nodes):
    bound, beyond = 0.125, 0.3
    assert missed(nodes, nodes / NODES_PER_PERIOD) < bound
    assert missed(nodes, 1.5 * nodes / NODES_PER_PERIOD) > beyond


@pytest.mark.parametrize(
    ("estimator", "most_hz"),
    [({}, 2.5), ({"nodes": 8}, 5.0), ({"window_s": 0.8}, 1.25)],
)
def test_a_mode_that_swings_faster_than_the_nodes_follow_is_warned_of(arm, estimator, most_hz):
    arm.data["estimator"] = estimator
    arm.data["modes"] = [tank(name="slow"), tank(mass_kg=5.0, frequency_hz=0.99 * most_hz)]
    assert validate(load(arm.write()))[1] == []
    arm.data["modes"][1]["frequency_hz"] = 1.01 * most_hz
    (line,) = validate(load(arm.write()))[1]
    assert_named(line, "modes.1.frequency_hz: ", " (tank) is above", f" {most_hz:g}, the most")
    assert_named(line, f"estimator.window_s {estimator.get('window_s', 0.4):g} follow")


@pytest.mark.parametrize("bus", ["arm", None])
def test_a_lag_shorter_than_the_delay_of_a_wheel_is_refused(arm, bus):
    arm.data["estimator"] = {"momentum_sigma_nms": 5.0, "lag_s": 0.15}
    late = wheel(bus=bus, node_id=None if bus is None else 0x21, delay_s=0.1)
    arm.data["wheels"] = [wheel(1), late]
    config = load(arm.write())
    slowest = "wheel1, 126." if bus else "star_tracker, 117."
    assert f"(slowest: {slowest}" in describe(config, validate(config)[0])
    late["delay_s"] = 0.2
    message = fault(arm)
    assert len(message.splitlines()) == 1
    assert_named(
        message, "estimator.lag_s: 0.15 is shorter", "wheels.1 with its delay_s 0.2;", "least 0.2"
    )
