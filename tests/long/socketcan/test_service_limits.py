"""What the systemd unit gives the loop is enough, on a machine where root may raise limits."""

import json
import subprocess
import sys

import pytest

LIMITED = """
import json, os
from fsw.scheduler.realtime import prepare
capabilities = next(l for l in open("/proc/self/status") if l.startswith("CapEff")).split()[1]
refused = prepare(None, 80)
locked = next(l for l in open("/proc/self/status") if l.startswith("VmLck")).split()[1]
policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
print(json.dumps([int(capabilities, 16), refused, policy == os.SCHED_FIFO, int(locked) > 0]))
"""


@pytest.mark.parametrize(("limit", "works"), [("unlimited:unlimited", True), ("0:0", False)])
def test_the_unit_s_limits_and_no_capability_are_enough(limit: str, works: bool) -> None:
    """The kernel asks for a capability, or for the limits that the unit sets."""
    priority = 99 if works else 0
    command = ["prlimit", f"--memlock={limit}", f"--rtprio={priority}:{priority}", "--"]
    command += ["setpriv", "--bounding-set=-all", "--inh-caps=-all", "--", sys.executable]
    done = subprocess.run([*command, "-c", LIMITED], capture_output=True, text=True, check=True)
    capabilities, refused, is_fifo, is_locked = json.loads(done.stdout)
    assert capabilities == 0
    assert (is_fifo, is_locked) == (works, works)
    assert (refused == []) is works
