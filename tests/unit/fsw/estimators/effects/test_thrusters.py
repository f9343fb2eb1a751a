"""States of valves to edges: times, time open, what is missed."""

import numpy as np
import pytest

from fsw.config.thrusters import ThrusterConfig
from fsw.estimators.effects.thrusters import Valves
from fsw.messages import ChannelWindow
from tests.support.thruster_cases import thruster_settings

NS = 1_000_000_000
W = 400_000_000  # window [ns]


def valves(count: int = 2) -> Valves:
    own = [ThrusterConfig.model_validate(thruster_settings(k)) for k in range(count)]
    return Valves(own, np.zeros(count))


def channel(index: int, *changes: tuple[float, float], start: float = 0.0) -> ChannelWindow:
    """A valve reported every 20 ms of a window, with changes (time from its start, state)."""
    rows = [((k + 0.5) * 0.02, None) for k in range(20)]
    rows += list(changes)
    state, t_ns, values = start, [], []
    for t_s, new in sorted(rows, key=lambda row: row[0]):
        state = state if new is None else new
        t_ns.append(index * W + round(t_s * NS))
        values.append([state, float(new is not None)])
    return ChannelWindow(t_ns=np.array(t_ns), values=np.array(values), missing=False, stale=False)


def look(own: Valves, index: int, *channels: ChannelWindow):
    found, missed = own.found(channels, index * W, (index + 1) * W)
    if found is None:
        return None, missed
    used = found["edges"][found["edges"][:, 2] != 0]
    return [(int(k), round(t, 6), int(sign)) for k, t, sign in used], missed


def test_changes_are_edges_from_the_window_s_centre_until_they_have_settled() -> None:
    own = valves()
    quiet = [channel(k) for k in range(5)]
    assert look(own, 0, channel(0, (0.1, 1.0), (0.3, 0.0)), quiet[0]) == (
        [(0, -0.1, 1), (0, 0.1, -1)],
        False,
    )
    assert look(own, 1, quiet[1], quiet[1])[0] == [(0, -0.5, 1), (0, -0.3, -1)]
    assert look(own, 4, quiet[4], quiet[4]) == ([], False)


def test_a_valve_that_stays_open_is_one_edge_long_ago_and_its_time_counts() -> None:
    own = valves(1)
    look(own, 0, channel(0, (0.1, 1.0)))
    for k in range(1, 4):
        found, _ = own.found([channel(k, start=1.0)], k * W, (k + 1) * W)
    assert found is not None
    assert found["opened_s"] == pytest.approx([1.1])
    (edge,) = found["edges"][found["edges"][:, 2] != 0]
    assert edge[2] == 1.0
    assert edge[1] < -0.2 - 20 * 0.01  # settled before the window
    found, _ = own.found([channel(9, start=1.0)], 9 * W, 10 * W)  # windows were not looked at
    assert found is not None
    assert found["opened_s"] == pytest.approx([3.5])


def test_missed_changes_and_silence_make_a_window_unusable() -> None:
    own = valves(1)
    assert look(own, 0, channel(0)) == ([], False)
    assert look(own, 1, channel(1, start=1.0)) == (None, True)  # no change was told
    assert look(own, 2, channel(2, start=1.0))[1] is False
    empty = ChannelWindow(
        t_ns=np.empty(0, np.int64), values=np.empty((0, 2)), missing=True, stale=True
    )
    assert look(own, 3, empty) == (None, False)
    unknown = channel(4, (0.2, np.nan))
    assert look(own, 4, unknown) == (None, True)
