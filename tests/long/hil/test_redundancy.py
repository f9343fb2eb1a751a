"""A redundant pair of buses in the whole loop: the bus is lost, the estimate is not."""

import numpy as np
import pytest

from hil.run import bench
from hil.run.bench import T0_NS
from tests.support.short_cases import NoMeter, on_two_buses, short

SYNC_HZ = 200.0
LOST_AFTER_S, NODES_TOGGLE_S = 0.1, 0.3


@pytest.fixture(scope="module")
def setup(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pair")
    return bench.prepare(on_two_buses(short(folder)), 1, folder)


def run(setup, *, nominal=(), redundant=()):
    """Run with outages [from, to) of either bus, in seconds of the run."""

    def disturb(world):
        for port, outages in ((world.can, nominal), (world.redundant, redundant)):
            port.outages_ns = [tuple(T0_NS + round(t * 1e9) for t in span) for span in outages]

    return bench.run_virtual(setup, NoMeter(), record=False, disturb=disturb)


def switches(recorded):
    return [(e.t_ns - T0_NS) * 1e-9 for e in recorded.events if e.code == "BUS_SWITCHED"]


def lost_s(recorded):
    """Longest time a joint was without samples, as its lost SYNCs tell."""
    return recorded.status["samples"]["arm"]["lost"] / 7 / SYNC_HZ


@pytest.fixture(scope="module")
def sound(setup):
    return run(setup)


def test_a_sound_bus_is_kept(sound):
    assert sound.status["buses"]["arm"]["active"] == "nominal"
    assert switches(sound) == []
    assert sound.status["samples"]["arm"]["lost"] == 0


def test_a_lost_bus_costs_a_gap_and_not_the_estimate(setup, sound):
    recorded = run(setup, nominal=[(5.0, 1e3)])
    (at_s,) = switches(recorded)
    assert 5.0 + LOST_AFTER_S < at_s <= 5.0 + LOST_AFTER_S + 0.03
    assert recorded.status["buses"]["arm"] == {
        "overflow": 0, "unsent": 0, "active": "redundant", "switches": 1,
    }  # fmt: skip
    # the nodes toggle once their patience is over, so the gap ends soon after that
    assert LOST_AFTER_S < lost_s(recorded) < NODES_TOGGLE_S + 0.05
    assert recorded.status["windows"]["unusable"] <= 2
    assert recorded.status["windows"]["closed"] == sound.status["windows"]["closed"]
    # the estimate went on from what it knew: never back to the prior, and nearly as sharp
    information = [e.information_gained_nats for e in recorded.estimates]
    assert min(np.diff(information)) > -0.5
    assert information[-1] > 0.9 * sound.estimates[-1].information_gained_nats
    assert recorded.final.valid == sound.final.valid


def test_a_bus_that_was_lost_before_the_start_is_left(setup):
    recorded = run(setup, nominal=[(0.0, 1e3)])
    # nobody heard yet: the master waits until every node could have met it
    assert switches(recorded)[0] == pytest.approx(LOST_AFTER_S + 2 * NODES_TOGGLE_S, abs=0.03)
    assert recorded.status["samples"]["arm"]["received"] > 0
    assert recorded.status["buses"]["arm"]["active"] == "redundant"


def test_after_both_buses_were_dead_for_longer_than_the_nodes_search_they_are_found(setup):
    dead = [(3.0, 6.0)]
    recorded = run(setup, nominal=dead, redundant=dead)
    assert recorded.estimates[-1].t_ns > T0_NS + round(8e9)  # goes on after the gap
    status = recorded.status["samples"]["arm"]
    gap_s = status["lost"] / 7 / SYNC_HZ
    assert 3.0 <= gap_s < 3.0 + 2 * (LOST_AFTER_S + 2 * NODES_TOGGLE_S)


def test_two_losses_go_there_and_back(setup):
    recorded = run(setup, nominal=[(3.0, 6.0)], redundant=[(7.0, 1e3)])
    assert len(switches(recorded)) == 2
    assert recorded.status["buses"]["arm"]["active"] == "nominal"
    assert lost_s(recorded) < 2 * (NODES_TOGGLE_S + 0.05)
