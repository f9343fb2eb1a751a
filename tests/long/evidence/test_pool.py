"""Processes that die take no case along: it runs again, and in the end is reported as lost."""

import os
import signal
from pathlib import Path

import pytest

from evidence.pool import MOST_ATTEMPTS, CaseLostError, over_processes


def dies_at_first(folder: Path) -> int:
    """Kill the own process the first time."""
    attempts = len(list(folder.iterdir()))
    (folder / str(attempts)).touch()
    if attempts == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return attempts


def always_dies(case: int) -> int:
    if case:
        os.kill(os.getpid(), signal.SIGKILL)
    return case


def own_process(_case: int) -> int:
    return os.getpid()


def test_a_case_whose_process_died_runs_again(tmp_path: Path) -> None:
    assert list(over_processes(dies_at_first, [tmp_path], 1)) == [(tmp_path, 1)]


def test_a_case_that_always_kills_its_process_is_lost_and_the_rest_is_not() -> None:
    found = dict(over_processes(always_dies, [1, 0], 1, lost=lambda case, _: -case))
    assert found == {0: 0, 1: -1}
    with pytest.raises(CaseLostError, match=f"died {MOST_ATTEMPTS} times"):
        list(over_processes(always_dies, [1], 1))


def test_every_case_may_have_a_process_of_its_own() -> None:
    pids = [pid for _, pid in over_processes(own_process, [1, 2, 3], 1, single=True)]
    assert len(set(pids)) == 3
    assert os.getpid() not in pids
