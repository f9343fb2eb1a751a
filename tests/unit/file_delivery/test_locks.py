"""Nobody waits for a lock without a bound, and no other user can take one."""

import fcntl
import os
import time

import pytest

from file_delivery import numbers as transactions
from file_delivery.locks import keep_lock, locked, take_lock
from file_delivery.numbers import Numbers
from ground import numbers as ground_numbers
from ground.errors import UsageError
from ground.numbers import NumberFile


def hold(path) -> int:
    """Hold a lock as another program would that may only read the file."""
    path.touch(0o644)
    descriptor = os.open(path, os.O_RDONLY)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    return descriptor


def test_a_lock_that_is_held_is_given_up_after_its_bound_and_named(tmp_path):
    other = hold(tmp_path / "lock")
    began_s = time.monotonic()
    with pytest.raises(TimeoutError, match=r"another process holds the lock.*lock"):
        take_lock(tmp_path / "lock", 0.2)
    assert 0.2 <= time.monotonic() - began_s < 2.0
    os.close(other)
    with locked(tmp_path / "lock", 0.2), pytest.raises(TimeoutError):
        take_lock(tmp_path / "lock", 0.0)


def test_a_lock_file_is_closed_to_others_whatever_it_was(tmp_path):
    (tmp_path / "old").touch(0o755)
    before = os.umask(0)
    try:
        for name in ("old", "new"):
            os.close(take_lock(tmp_path / name, 0.0))
            assert (tmp_path / name).stat().st_mode & 0o777 == 0o600
    finally:
        os.umask(before)


def test_a_lock_is_taken_again_when_its_file_was_removed(tmp_path):
    path = tmp_path / "lock"
    held = take_lock(path, 0.0)
    assert keep_lock(path, held) == held
    path.unlink()
    held = keep_lock(path, held)
    with pytest.raises(TimeoutError):
        take_lock(path, 0.0)
    path.unlink()
    other = take_lock(path, 0.0)
    with pytest.raises(TimeoutError):
        keep_lock(path, held)
    os.close(other)
    os.close(held)


def test_numbers_are_given_though_somebody_holds_the_lock(tmp_path, monkeypatch):
    monkeypatch.setattr(transactions, "WAIT_S", 0.1)
    monkeypatch.setattr(ground_numbers, "WAIT_S", 0.1)
    others = [hold(tmp_path / "transactions.lock"), hold(tmp_path / "key.lock")]
    assert Numbers(tmp_path / "transactions.number").take() > 0
    with pytest.raises(UsageError, match="holds the lock"):
        NumberFile(tmp_path / "key.json").change(lambda number: number + 1)
    for other in others:
        os.close(other)
