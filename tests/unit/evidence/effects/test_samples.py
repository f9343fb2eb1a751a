"""Valves as their node and their own changes tell of them."""

import numpy as np

from evidence.effects.samples import _valves
from hil.world.thrusters import Jet, Pulse, ThrusterSystem

SYSTEM = ThrusterSystem(
    jets=tuple(Jet(place_m=(0, 0, k), direction=(1, 0, 0), force_n=1.0) for k in range(2)),
    pulses=(
        Pulse(jet=0, on_s=0.03, for_s=0.04),
        Pulse(jet=1, on_s=0.01, for_s=0.04, reported=False),
    ),
)


def test_a_valve_has_its_changes_at_their_own_instants_and_reports_between():
    first, second = _valves(SYSTEM, np.array([0.0, 0.02, 0.04, 0.06, 0.08]))
    rows = [(round(t, 9), *own) for t, own in zip(first.t_s, first.values.tolist(), strict=True)]
    assert rows == [
        *((0.0, 0.0, 0.0), (0.02, 0.0, 0.0), (0.03, 1.0, 1.0), (0.04, 1.0, 0.0)),
        *((0.06, 1.0, 0.0), (0.07, 0.0, 1.0), (0.08, 0.0, 0.0)),
    ]
    assert not second.values.any()  # nobody reports it


def test_a_change_at_a_report_comes_before_it():
    system = SYSTEM.__class__(jets=SYSTEM.jets, pulses=(Pulse(jet=0, on_s=0.02, for_s=0.02),))
    found = _valves(system, np.array([0.0, 0.02, 0.04]))[0].values.tolist()
    assert found == [[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]
