"""SYNCs that follow one another, accepted at once and one by one."""

import numpy as np
import pytest

from fsw.drivers.sources.sync import SyncHistory

PERIOD_NS = 2_000_000


def began(counter: int) -> SyncHistory:
    history = SyncHistory(240, 500.0)
    assert history.add(bytes([counter]), 0, 0)
    return history


def test_at_once_is_as_one_by_one():
    counters = [239, 240, *range(1, 101)]
    stamps_ns = [PERIOD_NS * (k + 1) for k in range(len(counters))]
    rows = [8 * (k + 1) for k in range(len(counters))]
    at_once, one_by_one = began(238), began(238)
    assert at_once.follow(counters, stamps_ns, rows)
    for counter, t_ns, row in zip(counters, stamps_ns, rows, strict=True):
        assert one_by_one.add(bytes([counter]), t_ns, row)
    answers = np.array(counters), np.array(rows) + 1, np.array(stamps_ns) + 500_000
    for found, expected in zip(at_once.match(*answers), one_by_one.match(*answers), strict=True):
        assert np.array_equal(found, expected)
    assert (at_once.count, at_once.lost) == (one_by_one.count, one_by_one.lost) == (103, 0)
    assert not at_once.add(bytes([100]), stamps_ns[-1] + 1, 900)
    assert at_once.echoes == 1


@pytest.mark.parametrize("counters", [[4], [2, 3], [3, 5], [3, 3], [3, 4, 0]])
def test_those_that_do_not_follow_are_left_for_one_by_one(counters: list[int]):
    history = began(2)
    assert not history.follow(counters, [PERIOD_NS] * len(counters), [0] * len(counters))
    assert history.count == 1


def test_the_first_is_none_that_follows():
    assert not SyncHistory(240, 500.0).follow([1], [0], [0])
