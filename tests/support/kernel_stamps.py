"""Waiting until Linux stamps what a port receives."""

import pytest

from fsw.clock import MonotonicClock
from fsw.drivers.wire import FramePort

WAITING_ID = 0x080


def wait_for_kernel_stamps(port: FramePort, clock: MonotonicClock) -> None:
    """Send until a frame that comes back is stamped before it is read; all read by then is gone.

    Linux switches stamps on in a work item of its own, after the first socket has asked for them;
    on a busy machine that can take tens of milliseconds. What comes before has the time of its
    reading.
    """
    for _ in range(200):
        sent_ns = clock.now_ns()
        port.write(WAITING_ID, b"")
        clock.sleep_until_ns(sent_ns + 20_000_000)
        port.drain()
        if (port.take()()["t_ns"] < sent_ns + 10_000_000).any():
            return
    pytest.fail("no frame had the kernel's stamp within four seconds")
