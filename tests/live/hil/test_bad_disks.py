"""The short form of `hil faults --lane disk`: real small disks, the service in virtual time."""

import json
import os
import subprocess
import sys

import pytest


def test_bad_disks_take_neither_the_link_nor_what_was_kept(tmp_path):
    if os.geteuid() != 0:
        pytest.skip("this user may not mount a disk")
    command = [sys.executable, "-m", "hil", "faults", "--lane", "disk", "--short", "--json"]
    done = subprocess.run(
        [*command, "--jobs", "1", "--out", str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    if "mount" in done.stderr.splitlines()[-1]:
        pytest.skip("this machine has no loop devices")
    found = json.loads(done.stdout)["cases"]
    assert len(found) == 4
    assert [case["failed"] for case in found if case["failed"]] == []
    assert done.returncode == 0
    assert any("DISK_FULL" in case["events"] for case in found)
    assert any("TC_NOT_KEPT" in case["events"] for case in found)
