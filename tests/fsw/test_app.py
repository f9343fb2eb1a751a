"""The loop process and its service as real processes, on pseudo-terminals and a virtual bus."""

import json
import os
import pty
import signal
import subprocess
import sys
import time

import pytest

from fsw.control import control
from fsw.recording import contents, messages, unpack_frame
from tests.conftest import ArmProject

RUN = "import sys; from pathlib import Path; from fsw.app import run_live; " + (
    "from fsw.config import load; sys.exit(run_live(load(Path(sys.argv[1]))))"
)
PATIENCE_S = 60.0


class Run:
    """One daemon with its devices' terminals."""

    def __init__(self, arm: ArmProject) -> None:
        self.state = arm.folder / "state"
        self.recording = arm.folder / "recordings" / "recording_0001.mcap"
        self.terminals = [fd for _ in range(2) for fd in pty.openpty()]
        arm.data["imu"]["port"] = os.ttyname(self.terminals[1])
        arm.data["star_tracker"]["port"] = os.ttyname(self.terminals[3])
        path = arm.write()
        self.process = subprocess.Popen(
            [sys.executable, "-c", RUN, str(path)],
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        )

    def wait_status(self, running: bool) -> dict:
        """The first status file that says so."""
        path = self.state / "status.json"
        began = time.monotonic()
        while time.monotonic() - began < PATIENCE_S:
            if path.exists():
                status = json.loads(path.read_text())
                if status["running"] is running and status.get("ticks", 0) > 100:
                    return status
            time.sleep(0.05)
        raise TimeoutError(path)

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        for fd in self.terminals:
            os.close(fd)


@pytest.fixture
def run(arm: ArmProject):
    run = Run(arm)
    yield run
    run.close()


def test_a_daemon_is_commanded_ends_cleanly_on_sigterm_and_leaves_a_whole_recording(run: Run):
    run.wait_status(running=True)
    assert control(run.state, {"command": "status"})["data"]["samples"]["arm"]["sync"] > 0
    assert control(run.state, {"command": "reset"})["code"] == "ACCEPTED"
    assert control(run.state, {"command": "nonsense"})["code"] == "UNKNOWN_COMMAND"
    assert control(run.state, {"command": "adopt"})["code"] == "NO_RESULT"
    run.process.send_signal(signal.SIGTERM)
    assert run.process.wait(PATIENCE_S) == 0
    status = run.wait_status(running=False)
    held = contents(run.recording)
    assert not held.truncated
    assert held.metadata["recorder"] == {"dropped": "0"}
    assert {"configuration.yaml", "robot.urdf"} == set(held.attachments)
    frames = [unpack_frame(r.t_ns, r.data) for r in messages(run.recording, ["/can/arm"])]
    syncs = [f for f in frames if f is not None and f.can_id == 0x080]
    assert [f.data[0] for f in syncs[:500]] == [k % 240 + 1 for k in range(len(syncs[:500]))]
    assert len(syncs) == status["samples"]["arm"]["sync"]
    assert not (run.state / "ctl.sock").exists()


def test_when_the_loop_is_killed_the_service_closes_the_recording(run: Run):
    run.wait_status(running=True)
    run.process.kill()
    run.wait_status(running=False)
    assert not contents(run.recording).truncated
    events = (run.state / "events.jsonl").read_text()
    assert "LOOP_LOST" in events


def test_the_command_stop_ends_the_daemon(run: Run):
    run.wait_status(running=True)
    assert control(run.state, {"command": "stop"})["accepted"]
    assert run.process.wait(PATIENCE_S) == 0
