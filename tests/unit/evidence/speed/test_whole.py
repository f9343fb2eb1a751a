"""Grid points that a timer's late wake-ups missed; statuses that go with processor times."""

import json
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest

from evidence.speed.whole import FRESH_NS, SETTLE_S, _Watch, granted, missed, quantile
from offline.bench.timer import cyclictest_command, cyclictest_wakes

PERIOD_US = 2000.0


def test_a_wake_up_three_periods_late_misses_three_points() -> None:
    assert missed([(10, 500), (1999, 3), (2000, 1), (6500, 2)], PERIOD_US) == 1 + 2 * 3


def test_a_quantile_of_wake_ups_is_that_of_the_sorted_list() -> None:
    wakes = [(2000, 1), (10, 50), (300, 40), (900, 9)]
    every = sorted(late_us for late_us, count in wakes for _ in range(count))
    assert quantile(wakes, 0.99) == every[98] == 900
    assert quantile(wakes, 0.5) == every[49] == 10
    assert quantile([], 0.99) == 0.0


def test_a_priority_is_granted_as_to_the_loop_and_not_kept() -> None:
    allowed = subprocess.run(["chrt", "-f", "50", "true"], capture_output=True, check=False)
    assert granted(50) == (50 if allowed.returncode == 0 else 0)
    assert granted(0) == 0
    assert os.sched_getscheduler(0) == os.SCHED_OTHER


@pytest.mark.skipif(shutil.which("cyclictest") is None, reason="needs Debian's rt-tests")
def test_cyclictest_skips_what_it_missed_and_does_not_make_up() -> None:
    command = cyclictest_command(500.0, 2.0)
    assert command is not None
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        time.sleep(0.2)
        process.send_signal(signal.SIGSTOP)
        time.sleep(0.09)
        process.send_signal(signal.SIGCONT)
        output, _ = process.communicate()
    wakes = cyclictest_wakes(output)
    late = sum(count for late_us, count in wakes if late_us >= 45_000)
    assert 1 <= late <= 5  # made up, the points missed would be some twenty wake-ups more
    assert missed(wakes, PERIOD_US) >= 22


def test_only_a_new_and_fresh_status_goes_with_processor_times(tmp_path: Path) -> None:
    """A busy service writes late: 4400 ticks were counted to the 6 s of a run at 500 Hz."""
    path, started, pid = tmp_path / "status.json", [], os.getpid()
    watch = _Watch(path, lambda: started.append(1))

    def seen(age_ns: int, ticks: int) -> int | None:
        path.write_text(json.dumps({"t_ns": time.monotonic_ns() - age_ns, "ticks": ticks}))
        watch(SETTLE_S + 1.0, pid, pid)
        watch(SETTLE_S + 1.1, pid, pid)  # the same status again
        return None if watch.last is None else int(watch.last.status["ticks"])

    assert seen(2 * FRESH_NS, 1) is None
    assert seen(0, 2) == 2
    assert watch.last is not None
    assert watch.last.done_s == SETTLE_S + 1.0
    assert seen(2 * FRESH_NS, 3) == 2
    assert seen(0, 4) == 4
    assert (watch.first is not None and watch.first.status["ticks"], started) == (2, [1])
