"""Seven joints' frames from python-can to the daemon's port: each arrives, or is counted."""

import os
import subprocess
import sys
import time

import pytest

from fsw.clock import MonotonicClock
from fsw.drivers.ports.can_bus import open_can
from fsw.drivers.wire import frame_list
from tests.support.driver_configs import bus_config

REALTIME = os.environ["HIL_VCAN"] != "uml"  # else a busy machine may keep the reader waiting
JOINTS = 7
SECONDS = 4
SENDER = """
import sys, time, can
rate_hz, cycles, joints = float(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
with can.Bus(interface="socketcan", channel="vcan0") as bus:
    began_s = time.monotonic()
    for k in range(cycles):
        time.sleep(max(0.0, began_s + k / rate_hz - time.monotonic()))
        for joint in range(joints):
            data = k.to_bytes(8, "little")
            bus.send(can.Message(arbitration_id=0x191 + joint, data=data, is_extended_id=False))
"""


@pytest.mark.parametrize("rate_hz", [200, 400])
def test_no_frame_of_seven_joints_is_lost(rate_hz):
    cycles = rate_hz * SECONDS
    port = open_can(bus_config(interface="socketcan", channel="vcan0"), MonotonicClock())
    command = [sys.executable, "-c", SENDER, *map(str, (rate_hz, cycles, JOINTS))]
    seen = {0x191 + joint: [] for joint in range(JOINTS)}
    with subprocess.Popen(command) as sender:
        ended = False
        while not ended:
            ended = sender.poll() is not None  # before the last reads
            time.sleep(1.0 / rate_hz)
            port.drain()
            for frame in frame_list(port.take()()):
                seen[frame.can_id].append(int.from_bytes(frame.data, "little"))
    dropped = port.take_dropped()
    port.close()
    assert sender.returncode == 0
    received = sum(map(len, seen.values()))
    if REALTIME or dropped == 0:
        assert seen == {can_id: list(range(cycles)) for can_id in seen}
    assert received + dropped == JOINTS * cycles
