"""Kill -9 in a real-time run: ten of the two hundred, whatever else the machine has to do."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile

import pytest

COUNT = 10


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_killed_processes_come_back_and_nothing_readable_is_lost() -> None:
    """How late is not asked here: that is `hil kills --count 200` on a machine with time to spare.

    Every restart goes on from a whole checkpoint, no checkpoint is ever unreadable, every file of
    a recording is read to its end or its last flushed chunk without a gap.
    """
    with tempfile.TemporaryDirectory(prefix="kills-") as short:  # a socket's path must be
        command = [sys.executable, "-m", "hil", "kills", "--out", short, "--seed", "1"]
        done = subprocess.run(
            [*command, "--count", str(COUNT)], capture_output=True, text=True, check=False
        )
    result = json.loads(done.stdout)
    assert result["kills"] == COUNT, done.stderr
    assert result["faults"] == [], result
