"""A short form of `hil fuzz --only operations --live`."""

import json
import subprocess
import sys
import tempfile

import pytest

CASES = 300


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_hostile_operations_end_no_process_and_are_answered() -> None:
    with tempfile.TemporaryDirectory(prefix="fuzz-") as short:  # a socket's path must be
        command = [sys.executable, "-m", "hil", "fuzz", "--only", "operations", "--live"]
        command += ["--inputs", str(CASES), "--seed", "1", "--out", short]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    result = json.loads(done.stdout)
    assert result["cases"] >= CASES, done.stderr
    assert result["faults"] == [], "missed ticks are asked of the command on an idle machine"
    for kind in ("accepted", "lines", "uploads", "damaged", "repaired"):
        assert result[kind] > 0, kind
