from __future__ import annotations

from fsw.config import RedundantBusConfig
from fsw.drivers.sources import BusSelector

MS = 1_000_000
BOTH = (True, True)
PAIR = RedundantBusConfig(channel="b", lost_after_s=0.1, nodes_toggle_s=0.2)


def heard_until(t_ms: int) -> BusSelector:
    selector = BusSelector(PAIR)
    for t in range(0, t_ms + 1, 10):
        selector.hear(t * MS)
        assert selector.poll(t * MS, BOTH) == ""
    return selector


def test_the_bus_is_changed_when_no_node_is_heard_for_long_enough():
    selector = heard_until(1000)
    assert selector.poll(1100 * MS, BOTH) == ""
    assert selector.poll(1101 * MS, BOTH) == "no frame of any node for 0.10 s"
    assert (selector.active, selector.name, selector.switches) == (1, "redundant", 1)


def test_after_a_change_the_nodes_are_given_time_to_come():
    selector = heard_until(1000)
    selector.poll(1101 * MS, BOTH)
    assert selector.poll(1601 * MS, BOTH) == ""  # 0.1 s + 2 x 0.2 s after it
    assert selector.poll(1602 * MS, BOTH) != ""
    assert (selector.active, selector.switches) == (0, 2)


def test_a_node_heard_on_the_other_bus_keeps_it():
    selector = heard_until(1000)
    selector.poll(1101 * MS, BOTH)
    selector.hear(1300 * MS)
    assert selector.poll(1400 * MS, BOTH) == ""
    assert selector.poll(1401 * MS, BOTH) != ""  # short patience again


def test_at_the_start_the_patience_is_long():
    selector = BusSelector(PAIR)
    assert selector.poll(5000 * MS, BOTH) == ""
    assert selector.poll(5500 * MS, BOTH) == ""
    assert selector.poll(5501 * MS, BOTH) != ""


def test_a_port_that_is_down_is_left_at_once_and_never_taken():
    selector = heard_until(1000)
    assert selector.poll(1001 * MS, (False, True)) == "the port is down"
    assert selector.active == 1
    assert selector.poll(9000 * MS, (False, True)) == ""
    assert selector.poll(9001 * MS, (False, False)) == ""
    assert selector.poll(9002 * MS, BOTH) != ""
    assert selector.active == 0
