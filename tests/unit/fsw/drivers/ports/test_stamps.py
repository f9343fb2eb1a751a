"""Kernel stamps on the monotonic clock, with both clocks in the test's hand."""

import numpy as np
import pytest

from fsw.drivers.ports.stamps import KernelStamps

MS = 1_000_000
REALTIME_NS = 1_790_000_000_000_000_000  # less CLOCK_MONOTONIC


class Clocks:
    """Both clocks: monotonic time, and what the other is ahead of it."""

    def __init__(self) -> None:
        self.t_ns = 1000 * MS
        self.ahead_ns = REALTIME_NS

    def now_ns(self) -> int:
        return self.t_ns

    def compare(self) -> int:
        return -self.ahead_ns

    def stamp(self) -> int:
        return self.t_ns + self.ahead_ns


def times(stamps: KernelStamps, stamps_ns: list[int]) -> list[int]:
    return stamps.monotonic_ns(np.array(stamps_ns)).tolist()


@pytest.fixture
def clocks() -> Clocks:
    return Clocks()


@pytest.fixture
def stamps(clocks) -> KernelStamps:
    return KernelStamps(clocks, clocks.compare)


@pytest.mark.parametrize("waited_ns", [1, 40_000, 10 * MS, 19 * MS])
def test_a_frame_that_waited_in_the_kernel_through_a_read_keeps_its_time(clocks, stamps, waited_ns):
    stamp, sent_ns = clocks.stamp(), clocks.t_ns
    clocks.t_ns += waited_ns
    stamps.left_empty(clocks.t_ns)
    clocks.t_ns += 10 * MS
    later = clocks.stamp()
    clocks.t_ns += MS
    assert times(stamps, [stamp, later]) == [sent_ns, clocks.t_ns - MS]


def test_a_stamp_from_before_what_can_wait_is_that_of_the_read(clocks, stamps):
    stamp = clocks.stamp()
    clocks.t_ns += 21 * MS
    stamps.left_empty(clocks.t_ns)
    assert times(stamps, [stamp]) == [clocks.t_ns]


@pytest.mark.parametrize("set_ns", [-3_600_000 * MS, -MS, MS, 3_600_000 * MS])
def test_a_clock_that_is_set_moves_no_stamp_out_of_its_read(clocks, stamps, set_ns):
    clocks.t_ns += 10 * MS
    stamps.left_empty(clocks.t_ns)
    began_ns = clocks.t_ns
    clocks.t_ns += MS // 2
    before = clocks.stamp()
    clocks.ahead_ns += set_ns
    clocks.t_ns += MS // 2
    after, after_ns = clocks.stamp(), clocks.t_ns
    clocks.t_ns += MS
    times_ns = times(stamps, [before, after])
    assert began_ns <= times_ns[0] <= clocks.t_ns
    assert times_ns[1] == after_ns


def test_a_clock_that_was_set_is_believed_again_after_a_while(clocks, stamps):
    clocks.ahead_ns -= 50 * MS
    late = clocks.stamp()
    clocks.t_ns += 20 * MS
    stamps.left_empty(clocks.t_ns)
    assert times(stamps, [late]) == [clocks.t_ns]
    clocks.t_ns += 101 * MS
    late, late_ns = clocks.stamp(), clocks.t_ns
    clocks.t_ns += 20 * MS
    stamps.left_empty(clocks.t_ns)
    assert times(stamps, [late]) == [late_ns]


def test_a_clock_that_is_slewed_is_not_one_that_was_set(clocks, stamps):
    for _ in range(200):
        clocks.t_ns += 10 * MS
        clocks.ahead_ns += 5_000  # 500 ppm, the most that adjtime(3) does
        late, late_ns = clocks.stamp(), clocks.t_ns
        stamps.left_empty(late_ns + MS)
        clocks.t_ns += 2 * MS
        assert times(stamps, [late]) == [late_ns]


def test_what_is_not_stamped_has_the_time_of_the_read_before(clocks, stamps):
    clocks.t_ns += 10 * MS
    stamps.left_empty(clocks.t_ns)
    began_ns = clocks.t_ns
    clocks.t_ns += 10 * MS
    assert times(stamps, [0]) == [began_ns]


def test_no_stamp_is_later_than_now(clocks, stamps):
    assert times(stamps, [clocks.stamp() + 40_000]) == [clocks.t_ns]
