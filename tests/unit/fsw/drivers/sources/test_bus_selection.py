from fsw.config import RedundantBusConfig
from fsw.drivers.sources import BusSelector

MS = 1_000_000
BOTH = (True, True)
PAIR = RedundantBusConfig(channel="b", lost_after_s=0.1, nodes_toggle_s=0.2)


def heard_until(t_ms: int) -> BusSelector:
    selector = BusSelector(PAIR)
    for t in range(0, t_ms + 1, 10):
        selector.hear()
        assert selector.poll(t * MS, BOTH) == ""
    return selector


def changed_at(selector: BusSelector, from_ms: int, to_ms: int) -> list[int]:
    """Poll every millisecond without a frame; return when the bus was changed."""
    return [t for t in range(from_ms + 1, to_ms + 1) if selector.poll(t * MS, BOTH)]


def test_the_bus_is_changed_when_no_node_is_heard_for_long_enough():
    selector = heard_until(1000)
    assert changed_at(selector, 1000, 1100) == []
    assert selector.poll(1101 * MS, BOTH) == "no frame of any node for 0.10 s"
    assert (selector.active, selector.name, selector.switches) == (1, "redundant", 1)


def test_after_a_change_the_nodes_are_given_time_to_come():
    selector = heard_until(1000)
    # 0.1 s of silence, then 0.1 s + 2 x 0.2 s for every search
    assert changed_at(selector, 1000, 2200) == [1101, 1602, 2103]
    assert (selector.active, selector.switches) == (1, 3)


def test_a_node_heard_on_the_other_bus_keeps_it():
    selector = heard_until(1000)
    assert changed_at(selector, 1000, 1300) == [1101]
    selector.hear()
    assert changed_at(selector, 1300, 1402) == [1402]  # short patience again


def test_at_the_start_the_patience_is_long():
    assert changed_at(BusSelector(PAIR), 4999, 5501) == [5501]


def test_a_stall_of_the_loop_is_not_a_silence_of_the_nodes():
    selector = heard_until(1000)
    assert selector.poll(9000 * MS, BOTH) == ""
    assert changed_at(selector, 9000, 9100) == [9081]  # a fifth of the 0.1 s was counted


def test_a_port_that_is_down_is_left_at_once_and_never_taken():
    selector = heard_until(1000)
    assert selector.poll(1001 * MS, (False, True)) == "the port is down"
    assert selector.active == 1
    for t in range(1002, 9000):
        assert selector.poll(t * MS, (False, True)) == ""
    assert selector.poll(9001 * MS, (False, False)) == ""
    assert selector.poll(9002 * MS, BOTH) != ""
    assert selector.active == 0
