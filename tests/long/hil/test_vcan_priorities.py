"""`hil vcan --realtime`: who takes the processor from whom, outside and inside the machine."""

import json
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from hil.vcan import guest, kernel, uml
from hil.vcan.job import VcanError

ROOT = Path(__file__).parents[3]
INSIDE = """
import json, os, sys, time
time.sleep(2.5)
found = {}
for name in os.listdir("/proc"):
    if name.isdecimal():
        with open(f"/proc/{name}/comm") as file:
            found[name] = [file.read().strip(), os.sched_getscheduler(int(name)),
                           os.sched_getparam(int(name)).sched_priority]
with open("/proc/sys/kernel/sched_rt_runtime_us") as file:
    print(json.dumps([found, int(file.read())]), flush=True)
sys.stdin.read()
time.sleep(1)
"""


def can_be_had() -> bool:
    """Tell whether User-Mode Linux is installed and this user may use SCHED_FIFO."""
    try:
        uml.find("linux.uml")
        uml.find("ip")
    except VcanError:
        return False
    with uml.preferred(wanted=True) as granted:
        return granted


@pytest.mark.skipif(kernel.has_can(), reason="this kernel has CAN: hil vcan starts no guest")
@pytest.mark.skipif(not can_be_had(), reason="needs user-mode-linux, iproute2 and SCHED_FIFO")
def test_a_kernel_interrupts_what_computes_and_its_threads_serve_the_urgent_first():
    with subprocess.Popen(
        [sys.executable, "-m", "hil", "vcan", "--realtime", "--", sys.executable, "-c", INSIDE],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        text=True,
    ) as run:
        assert run.stdout is not None
        found, limit_us = json.loads(run.stdout.readline())
        outside = machine_priorities(run.pid)
        assert run.wait(timeout=60) == 0
    kernel_threads = [
        (policy, priority)
        for name, policy, priority in found.values()
        if name.startswith(("kworker", "ksoftirqd"))
    ]
    assert len(kernel_threads) >= 2
    assert set(kernel_threads) == {(os.SCHED_FIFO, guest.KERNEL_PRIORITY)}
    assert limit_us == -1
    assert outside[0][:2] == (os.SCHED_FIFO, uml.PRIORITY)
    assert len(outside) >= 3
    assert set(outside[1:]) in (
        {(os.SCHED_OTHER, 0, uml.NICE)},
        {(os.SCHED_FIFO, uml.PRIORITY - 1, 0)},
    )


def machine_priorities(ancestor: int) -> list[tuple[int, int, int]]:
    """Return policy, priority and nice value of a machine's processes: its kernel first."""
    parents: dict[int, int] = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            text = path.read_text("ascii", "replace")
            parents[int(path.parent.name)] = int(text.rpartition(")")[2].split()[1])
    first = next(pid for pid, parent in parents.items() if parent == ancestor)
    pids = [first, *sorted(pid for pid, parent in parents.items() if parent == first)]
    return [
        (
            os.sched_getscheduler(pid),
            os.sched_getparam(pid).sched_priority,
            os.getpriority(os.PRIO_PROCESS, pid),
        )
        for pid in pids
    ]
