"""Kill -9 in a real-time run: ten of the two hundred, whatever else the machine has to do."""

import json
import subprocess
import sys
import tempfile

import pytest

from evidence.kills.round import VICTIMS

COUNT = 10


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_killed_processes_come_back_and_nothing_readable_is_lost() -> None:
    """Every restart goes on from a whole checkpoint, every file is readable, nothing has a gap.

    How late is asked of the median only: of every kill that is `hil kills --count 200`, on a
    machine with time to spare.
    """
    with tempfile.TemporaryDirectory(prefix="kills-") as short:  # a socket's path must be
        command = [sys.executable, "-m", "hil", "kills", "--out", short, "--seed", "1"]
        done = subprocess.run(
            [*command, "--count", str(COUNT)], capture_output=True, text=True, check=False
        )
    result = json.loads(done.stdout)
    assert result["kills"] == COUNT, done.stderr
    assert result["faults"] == [], result
    seen = [result[victim] for victim in VICTIMS if victim in result]
    medians = [one["median_ratio"] for one in seen if one["kills"] >= 3]  # fewer: no median
    assert medians, result
    assert 1.0 < max(medians) <= result["bound_ratio"] == 2.5, result
