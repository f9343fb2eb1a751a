import numpy as np

from hil.devices.truth_clock import REST_S, ClampedHistory, JointTable, TruthClock
from tests.support.plant_cases import AnalyticHistory


def test_motion_starts_the_delay_after_the_first_sync():
    clock = TruthClock(4.0)
    assert clock.second(123) == REST_S
    clock.start(1_000_000_000)
    clock.start(9_000_000_000)
    assert clock.second(5_500_000_000) == 0.5
    assert clock.seconds(np.array([5_000_000_000])).tolist() == [0.0]


def test_table_equals_the_history_to_a_thousandth_of_an_encoder_count():
    history = AnalyticHistory()
    table = JointTable(ClampedHistory(history))
    times = np.random.default_rng(2).uniform(1.0, 59.0, 300)
    for t in np.sort(times).tolist() + times[:50].tolist():
        at = t + 0.002 * np.arange(64)
        q, qd, tau = table.at(at)
        state = history.at(at)
        assert np.abs(q - state.q).max() < 1e-3 * 2 * np.pi / 2**24
        assert np.abs(qd - state.qd).max() < 1e-9
        assert np.abs(tau - state.tau).max() < 1e-9


def test_history_rests_beyond_its_ends():
    history = AnalyticHistory()
    clamped = ClampedHistory(history)
    outside = clamped.at(np.array([-5.0, 70.0]))
    assert np.array_equal(outside.q, history.at(np.array([0.0, 60.0])).q)
