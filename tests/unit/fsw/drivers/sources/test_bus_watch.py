"""Who answered which SYNC, on answer patterns written down by hand."""

from collections.abc import Callable
from itertools import pairwise

import pytest

from fsw.drivers.sources.bus_watch import BusWatch

NODES = (1, 2, 3)
PERIOD_NS = 2_000_000
Answers = Callable[[int], list[tuple[int, int]]]  # SYNC to (node, SYNC answered), in order


def run(count: int, answers: Answers, rate_hz: float = 500.0) -> list[tuple[int, str, str]]:
    """Return SYNC, fault and subject of every finding; answers come behind the next SYNC."""
    watch = BusWatch("arm", {n: f"j{n}" for n in NODES}, rate_hz, 3.0, 2)
    found = []
    for k in range(count):
        watch.sync(k, k * PERIOD_NS)
        for node, sync in answers(k - 1) if k else ():
            watch.answer(node, sync, k * PERIOD_NS)
        found += [(k, str(f.fault), f.subject) for f in watch.take()]
    return found


def usual(k: int) -> list[tuple[int, int]]:
    return [(node, k) for node in NODES]


def test_nodes_that_answer_raise_nothing() -> None:
    assert run(500, usual) == []


@pytest.mark.parametrize("first", [1, 5])
def test_nodes_that_start_later_raise_nothing(first: int) -> None:
    assert run(100, lambda k: [a for a in usual(k) if a[0] != 2 or k >= first]) == []


def test_one_missing_answer_is_lost_when_it_is_settled() -> None:
    found = run(50, lambda k: [a for a in usual(k) if a != (2, 20)])
    assert found == [(23, "JOINT_LOST", "j2")]


def test_an_answer_of_nobody_is_a_lost_sync() -> None:
    assert run(50, lambda k: [] if k == 20 else usual(k)) == [(23, "SYNC_LOST", "arm")]


def test_an_answer_twice_is_a_duplicate_and_twice_of_all_a_doubled_sync() -> None:
    assert run(50, lambda k: usual(k) + [(2, k)] * (k == 20)) == [(23, "JOINT_DUPLICATE", "j2")]
    assert run(50, lambda k: usual(k) * (1 + (k == 20))) == [(23, "SYNC_DOUBLED", "arm")]


def test_an_overtaken_answer_is_out_of_order_and_not_lost() -> None:
    def swapped(k: int) -> list[tuple[int, int]]:
        own = [a for a in usual(k) if a != (2, 20)]
        return [*own, (2, 20)] if k == 21 else own

    assert run(50, swapped) == [(22, "JOINT_ORDER", "j2")]


def test_answers_a_period_late_are_late_and_neither_lost_nor_silent() -> None:
    def late(k: int) -> list[tuple[int, int]]:
        held = range(20, 30)
        own = [a for a in usual(k) if a[0] != 2 or k not in held]
        return [(2, k - 1)] * (k - 1 in held) + own

    found = run(60, late)
    assert {(fault, subject) for _, fault, subject in found} == {("JOINT_LATE", "j2")}
    assert len(found) == 10


def test_a_node_is_silent_after_three_periods_and_nothing_else_when_it_is_back() -> None:
    found = run(200, lambda k: [a for a in usual(k) if a[0] != 2 or not 20 <= k < 120])
    assert found[0] == (23, "JOINT_SILENT", "j2")
    assert {fault for _, fault, _ in found} == {"JOINT_SILENT"}
    assert len(found) == 2  # told again after fifty SYNCs


def test_a_bus_on_which_nobody_answers_is_silent_itself() -> None:
    found = run(100, lambda k: [] if 20 <= k < 40 else usual(k))
    assert found == [(23, "BUS_SILENT", "arm")]


@pytest.mark.parametrize("rate_hz", [20.0, 50.0, 100.0, 500.0, 1000.0])
@pytest.mark.parametrize(("silent", "subject"), [(NODES, "arm"), ((2,), "j2")])
def test_a_silence_that_goes_on_is_told_again_before_it_would_be_over(
    rate_hz: float, silent: tuple[int, ...], subject: str
) -> None:
    def answers(k: int) -> list[tuple[int, int]]:
        return [a for a in usual(k) if a[0] not in silent or k < 20]

    found = run(20 + round(3.0 * rate_hz), answers, rate_hz)
    assert {subject_ for _, _, subject_ in found} == {subject}
    told_s = [k / rate_hz for k, _, _ in found]
    apart_s = [b - a for a, b in pairwise(told_s)]
    assert len(apart_s) > 10
    assert max(apart_s) < 0.25  # half of the usual health.recover_s


def test_a_boot_up_explains_what_misses() -> None:
    watch = BusWatch("arm", {n: f"j{n}" for n in NODES}, 500.0, 3.0, 2)
    found = []
    for k in range(200):
        watch.sync(k, k * PERIOD_NS)
        for node, sync in usual(k - 1):
            if k and (node != 2 or not 100 <= sync < 104):
                watch.answer(node, sync, k * PERIOD_NS)
        if k == 102:
            watch.boot(2, k * PERIOD_NS)
        found += [(str(f.fault), f.subject) for f in watch.take()]
    assert found == [("NODE_RESTARTED", "j2")]


@pytest.mark.parametrize("told", [True, False])
def test_what_misses_while_there_is_no_port_is_no_lost_sync(told: bool) -> None:
    """The last SYNCs before the port goes are out, their answers never come."""
    watch = BusWatch("arm", {n: f"j{n}" for n in NODES}, 500.0, 3.0, 2)
    found = []
    gone = (100, 101, 102, 103) if told else (100,)
    for k in range(200):
        if told and k == 102:
            watch.without_port()
        watch.sync(k, k * PERIOD_NS)
        for node, sync in usual(k - 1):
            if k and sync not in gone:
                watch.answer(node, sync, k * PERIOD_NS)
        found += [(str(f.fault), f.subject) for f in watch.take()]
    assert found == ([] if told else [("SYNC_LOST", "arm")])
