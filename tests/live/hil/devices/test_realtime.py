import json
import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import can
import numpy as np
import pytest
import serial
import yaml

from hil.devices import realtime
from hil.devices.sagitta import frame
from hil.world.spline import JointSpline

ROBOTS = Path(__file__).parents[4] / "hil" / "robots"
PORT = 43_000 + os.getpid() % 900
ANSWER_S = 2.0  # after which a SYNC counts as not answered
BUS = {"interface": "udp_multicast", "channel": "239.74.163.2", "port": PORT}


def plant_file(folder: Path) -> Path:
    JointSpline(0.5, np.zeros((12, 7))).save(folder / "rest.yaml")
    mounting = {"p_BS_m": [0.1, 0.0, 0.2], "q_BS_xyzw": [0.0, 0.0, 0.0, 1.0]}
    document = {
        "robot": {"urdf": str(ROBOTS / "lbr3_satellite.urdf"), "tool_frame": "tool"},
        "trajectory": "rest.yaml",
        "start_delay_s": 0.5,
        "seed": 5,
        "sensors": {
            "joints": {"torque_noise_nm": 0.03, "torque_offset_sigma_nm": 0.1},
            "imu": mounting
            | {
                "angle_random_walk_rad_sqrt_s": 4.4e-5,
                "velocity_random_walk_m_s_sqrt_s": 4e-4,
                "gyro_bias_sigma_rad_s": 1e-5,
                "acc_bias_sigma_m_s2": 5e-3,
            },
            "star_tracker": {"q_BS_xyzw": [0.0, 0.0, 0.0, 1.0], "rate_hz": 20.0},
        },
        "links": {
            "buses": [{"name": "arm", "fd": True, **BUS}],
            "imu": "run/imu",
            "star_tracker": "run/star_tracker",
        },
    }
    path = folder / "plant.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    return path


def exchange(bus: can.BusABC, imu: serial.Serial, ticks: int) -> tuple[list[can.Message], bytes]:
    """Send SYNCs at 100 Hz or, where the machine is busy, as fast as the seven nodes answer."""
    messages, received = [], b""
    for k in range(ticks):
        sync = can.Message(arbitration_id=0x080, data=[k % 240 + 1], is_extended_id=False)
        sent, awaited = time.monotonic(), len(messages) + 7
        bus.send(sync)
        while time.monotonic() < sent + (0.01 if len(messages) >= awaited else ANSWER_S):
            for end in select.select([bus, imu], (), (), 0.002)[0]:
                if end is bus:
                    messages += filter(is_answer, [bus.recv(0)])
                else:
                    received += os.read(imu.fileno(), 4096)
    return messages, received


def is_answer(message: can.Message | None) -> bool:
    return message is not None and 0x190 < message.arbitration_id < 0x198


@pytest.mark.parametrize("held_up", range(6))
def test_two_clocks_are_compared_though_one_comparison_is_interrupted(monkeypatch, held_up):
    now_ns, readings, offset_ns = 1_000_000_000, 0, -123_456_789_012

    def read(shift_ns):
        nonlocal now_ns, readings
        now_ns += 5_000_000 if readings == held_up else 100
        readings += 1
        return now_ns - shift_ns

    monkeypatch.setattr(time, "monotonic_ns", lambda: read(0))
    monkeypatch.setattr(time, "time_ns", lambda: read(offset_ns))
    assert abs(realtime.monotonic_less_realtime_ns() - offset_ns) < 1000


@pytest.mark.timeout(30)
def test_process_answers_sync_and_streams_over_pseudo_terminals(tmp_path):
    command = [sys.executable, "-m", "hil.devices", str(plant_file(tmp_path))]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        ready = json.loads(process.stdout.readline())
        assert ready["ready"] is True
        with (
            can.Bus(**BUS) as bus,
            serial.Serial(str(tmp_path / "run" / "imu"), 921_600, timeout=0) as imu,
            serial.Serial(str(tmp_path / "run" / "star_tracker"), 115_200, timeout=0.5) as tracker,
        ):
            tracker.write(frame(bytes([0x21, 0, 18, 24]) + bytes(15)))
            messages, received = exchange(bus, imu, 40)
            solution = tracker.read(180)
        process.send_signal(signal.SIGTERM)
        stopped = json.loads(process.stdout.readline())
        assert process.wait(5) == 0
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
    counters = {
        node: [m.data[7] for m in messages if m.arbitration_id == 0x180 + node]
        for node in range(0x11, 0x18)
    }
    # every SYNC answered by every node with its own counter, in order
    for echoed in counters.values():
        assert echoed == list(range(1, 41))
    assert len(received) > 42 * 100
    assert received[0] == received[42] == received[84] == 0xA5
    assert b"\xc0\x21\x84\x18" in solution
    assert stopped["stopped"] is True
    assert stopped["send_errors"] == 0
    assert not (tmp_path / "run" / "imu").exists()


def test_a_wrong_file_ends_with_one_message_and_code_two(tmp_path):
    path = plant_file(tmp_path)
    path.write_text(path.read_text(encoding="utf-8") + "sed: 3\n", encoding="utf-8")
    command = [sys.executable, "-m", "hil.devices", str(path)]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=30)
    assert result.returncode == 2
    assert "sed" in result.stderr
    assert result.stdout == ""
