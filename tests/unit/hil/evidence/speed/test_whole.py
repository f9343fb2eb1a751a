"""Grid points that a timer's late wake-ups missed."""

import shutil
import signal
import subprocess
import time

import pytest

from fsw.commands.bench.timer import cyclictest_command, cyclictest_wakes
from hil.evidence.speed.whole import missed

PERIOD_US = 2000.0


def test_a_wake_up_three_periods_late_misses_three_points() -> None:
    assert missed([(10, 500), (1999, 3), (2000, 1), (6500, 2)], PERIOD_US) == 1 + 2 * 3


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
