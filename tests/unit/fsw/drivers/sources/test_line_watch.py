"""What is missing and what was skipped tell the faults of a line apart."""

import pytest

from fsw.drivers.sources.line_watch import IMU_LINE, LineWatch

PERIOD_NS = 2_000_000
LENGTH = 42


def watch() -> LineWatch:
    return LineWatch(IMU_LINE, "imu", PERIOD_NS, 3.0)


@pytest.mark.parametrize(
    ("skipped", "lost", "fault"),
    [
        (0, 1, "IMU_LOST"),
        (0, 2, "IMU_LOST"),
        (0, 3, "IMU_SILENT"),
        (42, 1, "IMU_CRC"),
        (84, 2, "IMU_CRC"),
        (41, 1, "IMU_BYTES_LOST"),
        (1, 1, "IMU_BYTES_LOST"),
        (7, 0, "IMU_NOISE"),
        (90, 1, "IMU_NOISE"),
    ],
)
def test_counts_tell_the_fault(skipped: int, lost: int, fault: str) -> None:
    tested = watch()
    tested.accepted(0, 0, 0, LENGTH)
    assert tested.take() == []
    tested.accepted(PERIOD_NS, skipped, lost, LENGTH)
    (found,) = tested.take()
    assert (found.fault, found.subject, found.t_ns) == (fault, "imu", PERIOD_NS)


def test_a_frame_that_was_refused_is_not_missing() -> None:
    tested = watch()
    tested.accepted(0, 0, 0, LENGTH)
    tested.refused(PERIOD_NS, 0)
    tested.accepted(2 * PERIOD_NS, 0, 1, LENGTH)
    assert tested.take() == []


def test_silence_is_told_after_three_periods_and_again_while_it_lasts() -> None:
    tested = watch()
    tested.watch(10**9, up=True)
    assert tested.take() == []  # has never spoken
    tested.accepted(10**9, 0, 0, LENGTH)
    told = []
    for k in range(1, 120):
        tested.watch(10**9 + k * PERIOD_NS, up=True)
        told += [k] * len(tested.take())
    assert told == [3, 53, 103]


def test_a_line_that_never_gives_a_usable_frame_is_silent_after_five_seconds() -> None:
    tested, told = watch(), []
    for k in range(60):
        tested.watch(10**9 + k * 10**8, up=True, words="no time")
        told += [(k, finding.text) for finding in tested.take()]
    assert [k for k, _ in told] == list(range(50, 60))
    assert told[0][1] == "nothing usable for 5.000 s; no time"


def test_a_line_that_sends_refused_frames_from_the_start_is_not_silent() -> None:
    tested = watch()
    for k in range(100):
        tested.refused(k * 10**8, 0)
        tested.watch(k * 10**8, up=True)
    assert tested.take() == []


def test_a_line_without_its_port_is_not_silent() -> None:
    tested = watch()
    tested.accepted(10**9, 0, 0, LENGTH)
    for k in range(100):
        tested.watch(10**9 + k * PERIOD_NS, up=not 1 <= k <= 50)
    tested.accepted(10**9 + 100 * PERIOD_NS, 0, 99, LENGTH)
    assert tested.take() == []
    tested.accepted(10**9 + 102 * PERIOD_NS, 0, 1, LENGTH)
    assert [f.fault for f in tested.take()] == ["IMU_LOST"]


def test_a_line_whose_frames_are_all_refused_is_not_silent() -> None:
    tested = watch()
    tested.accepted(0, 0, 0, LENGTH)
    for k in range(1, 20):
        tested.refused(k * PERIOD_NS, 0)
        tested.watch(k * PERIOD_NS, up=True)
    tested.accepted(20 * PERIOD_NS, 0, 19, LENGTH)
    assert tested.take() == []
