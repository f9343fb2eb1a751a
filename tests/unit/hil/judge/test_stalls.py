"""Stalls of the bench's own process: noted where it acts late, and what they explain."""

import pytest

from fsw.messages import Event
from hil.devices.realtime import STALL_NS, Stalls
from hil.judge.stalls import bench_stalls

MS = 1_000_000


def event(t_ns: int, code: str) -> Event:
    return Event(t_ns, "medium", code, "joint1")


def test_what_is_done_in_time_is_no_stall() -> None:
    stalls = Stalls()
    stalls.note(10 * MS, 10 * MS + STALL_NS - 1)
    stalls.note(12 * MS, 11 * MS)
    assert stalls.found == []


def test_late_actions_of_one_stall_are_one_stall() -> None:
    stalls = Stalls()
    stalls.note(10 * MS, 18 * MS)
    stalls.note(9 * MS, 19 * MS)  # what else was due
    stalls.note(40 * MS, 45 * MS)
    assert stalls.found == [(9 * MS, 19 * MS), (40 * MS, 45 * MS)]


def test_a_stall_explains_lateness_behind_it_and_nothing_else() -> None:
    stalls = [(1000 * MS, 1008 * MS)]
    events = [
        event(990 * MS, "JOINT_LATE"),  # before it
        event(1040 * MS, "JOINT_LATE"),
        event(1040 * MS, "JOINT_LATE"),
        event(1040 * MS, "TORQUE_STUCK"),  # not a matter of time
        event(1040 * MS, "JOINT_LOST"),
        event(1500 * MS, "BUS_SILENT"),  # too long behind it
    ]
    found = bench_stalls(events, stalls)
    explains = {"JOINT_LATE": 2}
    assert found == {"count": 1, "longest_s": 0.008, "covered_s": 0.158, "explains": explains}


def test_windows_of_explanation_that_overlap_count_once() -> None:
    stalls = [(2000 * MS, 2010 * MS), (1000 * MS, 1050 * MS), (1100 * MS, 1120 * MS)]
    assert bench_stalls([], stalls)["covered_s"] == pytest.approx(0.270 + 0.160)


def test_without_a_stall_nothing_is_explained() -> None:
    found = bench_stalls([event(0, "JOINT_LATE")], [])
    assert found == {"count": 0, "longest_s": 0.0, "covered_s": 0.0, "explains": {}}
