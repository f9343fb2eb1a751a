"""A service waits for the one before it, says so, and never waits without a bound."""

import os
import signal
import subprocess
import sys
import time

import pytest

from fsw.service import turn
from fsw.service.turn import LOCK_NAME, take_turn

HOLD = """
import fcntl, os, sys, time
fcntl.flock(os.open(sys.argv[1], os.O_RDWR | os.O_CREAT), fcntl.LOCK_EX)
print("held", flush=True)
time.sleep(600)
"""
ENDED = "4194000"  # a process that does not exist


@pytest.fixture
def holder(tmp_path):
    """A process that holds the lock; its arguments are those of a service of another loop."""
    started = []

    def start(*words: str) -> subprocess.Popen:
        command = [sys.executable, "-c", HOLD, str(tmp_path / LOCK_NAME), *words]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        started.append(process)
        assert process.stdout.readline() == "held\n"
        return process

    yield start
    for process in started:
        process.kill()
        process.wait()
        process.stdout.close()


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(turn, "PATIENCE_S", 0.2)
    monkeypatch.setattr(turn, "KILLED_S", 1.0)


def test_a_service_whose_loop_has_ended_and_that_hangs_is_killed(tmp_path, holder, capsys):
    process = holder("fsw.service.process", "--parent", ENDED, "--end")
    process.send_signal(signal.SIGSTOP)
    os.close(take_turn(tmp_path, 0.5))
    assert process.wait(10.0) == -signal.SIGKILL
    told = capsys.readouterr().err.splitlines()
    assert f"held by process {process.pid}" in told[0]
    assert "hangs and is killed" in told[1]


@pytest.mark.parametrize("words", [(), ("fsw.service.process", "--parent", str(os.getpid()), "")])
def test_a_stranger_and_a_service_at_work_are_named_and_left_alone(tmp_path, holder, capsys, words):
    process = holder(*words)
    began_s = time.monotonic()
    with pytest.raises(TimeoutError, match="holds the lock"):
        take_turn(tmp_path, 0.5)
    assert time.monotonic() - began_s < 5.0
    assert process.poll() is None
    assert f"held by process {process.pid}" in capsys.readouterr().err


def test_a_service_that_ends_in_time_is_followed_at_once(tmp_path, holder, capsys):
    process = holder("fsw.service.process", "--parent", ENDED, "--end")
    process.terminate()
    os.close(take_turn(tmp_path, 5.0))
    assert "killed" not in capsys.readouterr().err
    assert (tmp_path / LOCK_NAME).stat().st_mode & 0o777 == 0o600


def test_a_service_that_gets_no_turn_ends_with_a_line(tmp_path, holder):
    holder()
    code = (
        "import os, sys; from fsw.service import process, turn; "
        "turn.PATIENCE_S = turn.KILLED_S = 0.1; turn.LONGEST_S = 0.1; "
        "from tests.conftest import ArmProject; from fsw.config import load; "
        "from fsw.exchange.ring import RingWriter; from fsw.exchange.ringlink import hand_down; "
        f"from pathlib import Path; arm = ArmProject(Path({str(tmp_path)!r})); "
        f"arm.data['service']['state_directory'] = {str(tmp_path)!r}; "
        "rings = [str(RingWriter.create(65536).fd) for _ in range(3)]; "
        "take = turn.take_turn; process.take_turn = lambda path: take(path, 0.1); "
        "fd = str(hand_down(load(arm.write()))); "
        "sys.exit(process.main(['--down', rings[0], '--found', rings[1], '--up', rings[2], "
        "'--config', fd, '--parent', str(os.getppid())]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 1, done.stderr
    assert "holds the lock" in done.stderr.splitlines()[-1]
