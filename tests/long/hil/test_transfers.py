"""File transfers in a row, some of them interrupted: a short form of `hil transfers`."""

import json
import subprocess
import sys
import tempfile

import pytest

from evidence.transfers.campaign import INTERRUPTIONS

COUNT = 16
SEED = "2"  # its sixteen have every kind of interruption


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_every_transfer_ends_right_or_with_its_reason() -> None:
    with tempfile.TemporaryDirectory(prefix="files-") as short:  # a socket's path must be
        command = [sys.executable, "-m", "hil", "transfers", "--out", short, "--seed", SEED]
        done = subprocess.run(
            [*command, "--count", str(COUNT)], capture_output=True, text=True, check=False
        )
    result = json.loads(done.stdout)
    assert result["transfers"] == COUNT, done.stderr
    assert result["faults"] == [], "how late is asked of `hil transfers` on an idle machine"
    assert result["undisturbed"]["right"] == result["undisturbed"]["transfers"]
    assert sum(result[kind]["transfers"] for kind in INTERRUPTIONS) >= COUNT // 8
