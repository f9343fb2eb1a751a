"""Loop, estimation and service as real processes, on pseudo-terminals and a virtual bus."""

import json
import os
import pty
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from fsw.clock import MonotonicClock
from fsw.drivers.wire import unpack_frame
from fsw.errors import PortError
from fsw.exchange.checkpoint import decode
from fsw.exchange.recording import contents, messages, messages_of
from fsw.exchange.recording_parts import parts_of
from fsw.loop import processes
from fsw.loop.app import drive
from fsw.service.control import control
from tests.conftest import ArmProject

RUN = "import sys; from pathlib import Path; from fsw.loop.app import run_live; " + (
    "from fsw.config import load; sys.exit(run_live(load(Path(sys.argv[1]))))"
)
PATIENCE_S = 60.0


class Run:
    """One daemon with its devices' terminals."""

    def __init__(self, arm: ArmProject) -> None:
        self.state = arm.folder / "state"
        self.notify = f"fsw-test-{os.getpid()}-{id(self)}"
        self.manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.manager.bind(f"\0{self.notify}")
        self.manager.settimeout(PATIENCE_S)
        self.recording = arm.folder / "recordings" / "recording_0001.mcap"
        self.terminals = [fd for _ in range(2) for fd in pty.openpty()]
        arm.data["imu"]["port"] = os.ttyname(self.terminals[1])
        arm.data["star_tracker"]["port"] = os.ttyname(self.terminals[3])
        arm.data["service"]["checkpoint_period_s"] = 0.5
        self.path = arm.write()
        self.errors = arm.folder / "stderr"
        self.start(self.path)

    def start(self, path: Path) -> None:
        with self.errors.open("ab") as errors:
            self.process = subprocess.Popen(
                [sys.executable, "-c", RUN, str(path)],
                env=os.environ | {"OPENBLAS_NUM_THREADS": "1", "NOTIFY_SOCKET": f"@{self.notify}"},
                stderr=errors,
            )

    def told_systemd(self) -> str:
        """The next thing said to the service manager."""
        return self.manager.recv(100).decode()

    def wait_event(self, code: str) -> dict:
        """The first event with the code."""
        began = time.monotonic()
        while time.monotonic() - began < PATIENCE_S:
            for event in self.events():
                if event["code"] == code:
                    return event
            time.sleep(0.05)
        raise TimeoutError(code)

    def events(self) -> list[dict]:
        path = self.state / "events.jsonl"
        lines = path.read_text().splitlines() if path.exists() else []
        return [json.loads(line) for line in lines]

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
        self.manager.close()
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


def child(pid: int, name: str) -> int:
    """The child process of a daemon that is its service, or its estimation."""
    pids = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    module = f".{name}.process".encode()
    (found,) = [int(k) for k in pids if module in Path(f"/proc/{k}/cmdline").read_bytes()]
    return found


def wait_for(condition: Callable[[], bool]) -> None:
    began = time.monotonic()
    while not condition():
        if time.monotonic() - began > PATIENCE_S:
            raise TimeoutError(condition)
        time.sleep(0.02)


def test_a_killed_daemon_goes_on_from_its_checkpoint(run: Run):
    run.wait_status(running=True)
    wait_for((run.state / "checkpoint.1").exists)
    run.process.kill()
    run.process.wait()
    run.start(run.path)
    event = run.wait_event("STATE_RESTORED")
    assert "all of it" in event["text"]
    wait_for(lambda: run.recording.with_name("recording_0002.mcap").exists())
    run.wait_status(running=True)
    assert control(run.state, {"command": "restore_state"})["code"] == "ACCEPTED"
    assert control(run.state, {"command": "save_state"})["code"] == "ACCEPTED"
    run.process.send_signal(signal.SIGTERM)
    assert run.process.wait(PATIENCE_S) == 0
    held = contents(run.recording.with_name("recording_0002.mcap"))
    assert "checkpoint.bin" in held.attachments
    assert decode(held.attachments["checkpoint.bin"]).snapshot.state["names"]


def test_a_killed_service_is_started_again_and_nothing_flushed_is_lost(run: Run):
    before = run.wait_status(running=True)
    service = child(run.process.pid, "service")
    os.kill(service, signal.SIGKILL)
    run.wait_event("SERVICE_LOST")
    wait_for(lambda: run.wait_status(running=True)["ticks"] > before["ticks"] + 1000)
    assert control(run.state, {"command": "status"})["accepted"]
    run.process.send_signal(signal.SIGTERM)
    assert run.process.wait(PATIENCE_S) == 0
    counts = json.loads((run.state / "status.json").read_text())["event_counts"]
    assert (counts["SERVICE_LOST"], counts["STARTED"], counts["SERVICE_BACK"]) == (1, 1, 1)
    parts = parts_of(run.recording)
    assert len(parts) == 2
    assert not contents(parts[1]).truncated
    counters = syncs_of(parts)
    breaks = [k for k, c in enumerate(counters[1:]) if c != counters[k] % 240 + 1]
    assert len(breaks) <= 1  # the chunk that was not flushed


def syncs_of(parts: list[Path]) -> list[int]:
    """Counters of the recorded SYNCs."""
    frames = [unpack_frame(r.t_ns, r.data) for r in messages_of(parts, ["/can/arm"])]
    return [f.data[0] for f in frames if f is not None and f.can_id == 0x080]


def test_a_killed_estimation_stops_no_acquisition_and_goes_on_from_its_checkpoint(run: Run):
    run.wait_status(running=True)
    wait_for((run.state / "checkpoint.1").exists)
    os.kill(child(run.process.pid, "estimation"), signal.SIGKILL)
    for code in ("ESTIMATION_LOST", "ESTIMATION_BACK", "STATE_RESTORED"):
        run.wait_event(code)
    before = run.wait_status(running=True)
    wait_for(lambda: run.wait_status(running=True)["windows"]["closed"] > 5)
    wait_for(lambda: run.wait_status(running=True)["ticks"] > before["ticks"] + 500)
    assert control(run.state, {"command": "save_state"})["code"] == "ACCEPTED"
    run.process.send_signal(signal.SIGTERM)
    assert run.process.wait(PATIENCE_S) == 0
    status = run.wait_status(running=False)
    assert status["event_counts"]["ESTIMATION_LOST"] == 1
    assert status["ring"]["dropped"] == status["recorder"]["dropped"] == 0
    counters = syncs_of(parts_of(run.recording))
    assert counters == [k % 240 + 1 for k in range(len(counters))]
    assert len(counters) > 500


def test_a_stalled_estimation_holds_nothing_up(run: Run):
    before = run.wait_status(running=True)
    estimation = child(run.process.pid, "estimation")
    os.kill(estimation, signal.SIGSTOP)
    wait_for(lambda: run.wait_status(running=True)["ticks"] > before["ticks"] + 1500)
    os.kill(estimation, signal.SIGCONT)
    closed = before["windows"]["closed"]
    wait_for(lambda: run.wait_status(running=True)["windows"]["closed"] > closed + 5)
    run.process.send_signal(signal.SIGTERM)
    assert run.process.wait(PATIENCE_S) == 0
    status = run.wait_status(running=False)
    assert "ESTIMATION_LOST" not in status["event_counts"]
    counters = syncs_of(parts_of(run.recording))
    assert counters == [k % 240 + 1 for k in range(len(counters))]
    assert status["samples"]["arm"]["sync"] == len(counters)


@pytest.mark.parametrize("name", ["service", "estimation"])
def test_the_watchdog_is_stroked_while_all_are_at_work_and_only_then(run: Run, name: str):
    assert [run.told_systemd() for _ in range(3)] == ["READY=1", "WATCHDOG=1", "WATCHDOG=1"]
    stopped = child(run.process.pid, name)
    os.kill(stopped, signal.SIGSTOP)
    stopped_s = time.monotonic()
    run.manager.settimeout(2.5)  # longer than the second between two strokes
    with suppress(TimeoutError):
        while run.told_systemd() == "WATCHDOG=1":
            assert time.monotonic() - stopped_s < 20.0
    assert time.monotonic() - stopped_s < 20.0
    os.kill(stopped, signal.SIGCONT)
    run.manager.settimeout(PATIENCE_S)
    assert run.told_systemd() == "WATCHDOG=1"
    run.process.send_signal(signal.SIGTERM)
    assert run.process.wait(PATIENCE_S) == 0
    run.manager.settimeout(0.0)
    last = ""
    with suppress(BlockingIOError):
        while True:
            last = run.told_systemd()
    assert last == "STOPPING=1"


@pytest.mark.parametrize("step", [1, 2, 3, 7])
def test_what_is_due_each_second_is_done_whichever_ticks_are_missed(step: int):
    """A loop at twice its period has even indices only: 99 of 100 is never one of them."""
    indices = list(range(0, 1001, step))
    done: list[int] = []
    often: list[int] = []
    left = iter(indices)
    turned: list[int] = []

    def turn() -> int:
        turned.append(next(left))
        return turned[-1]

    duties = ((10, lambda: often.append(turned[-1])), (100, lambda: done.append(turned[-1])))
    drive(turn, duties, lambda: len(turned) == len(indices))
    assert len(often) == indices[-1] // 10
    assert len(done) == indices[-1] // 100
    assert all(100 * k <= index < 100 * k + step for k, index in enumerate(done, start=1))


def test_a_second_daemon_on_the_same_state_is_refused(run: Run, monkeypatch: pytest.MonkeyPatch):
    run.wait_status(running=True)
    monkeypatch.setattr(processes, "LOCK_WAIT_NS", 0)
    with pytest.raises(PortError, match="another daemon"):
        processes.lock_state(run.state, MonotonicClock())


def test_the_command_stop_ends_the_daemon(run: Run):
    run.wait_status(running=True)
    assert control(run.state, {"command": "stop"})["accepted"]
    assert run.process.wait(PATIENCE_S) == 0


def test_a_state_directory_removed_under_way_is_made_again_and_stays_locked(
    run: Run, monkeypatch: pytest.MonkeyPatch
):
    run.wait_status(running=True)
    shutil.rmtree(run.state)
    run.wait_event("STATE_REMOVED")
    run.wait_status(running=True)
    began = time.monotonic()
    while not (run.state / "loop.lock").exists() and time.monotonic() - began < PATIENCE_S:
        time.sleep(0.05)
    monkeypatch.setattr(processes, "LOCK_WAIT_NS", 0)
    with pytest.raises(PortError, match="another daemon"):
        processes.lock_state(run.state, MonotonicClock())
    while not (run.state / "ctl.sock").exists() and time.monotonic() - began < PATIENCE_S:
        time.sleep(0.05)
    assert control(run.state, {"command": "stop"})["accepted"]
    assert run.process.wait(PATIENCE_S) == 0
    assert [event["code"] for event in run.events()].count("STATE_REMOVED") == 1


def test_recordings_removed_under_way_continue_in_a_new_part(run: Run):
    run.wait_status(running=True)
    shutil.rmtree(run.recording.parent)
    assert "removed under way" in run.wait_event("RECORDER_FAILED")["text"]
    run.wait_event("RECORDER_BACK")
    run.process.send_signal(signal.SIGTERM)
    assert run.process.wait(PATIENCE_S) == 0
    (part,) = run.recording.parent.glob("*.mcap")
    assert part.name == "recording_0001_0002.mcap"
    assert not contents(part).truncated


def test_nothing_that_a_daemon_writes_can_be_read_by_others(arm: ArmProject):
    before = os.umask(0)
    try:
        run = Run(arm)
    finally:
        os.umask(before)
    try:
        run.wait_status(running=True)
        found = [run.state, *run.state.rglob("*"), *run.recording.parent.iterdir()]
        assert len(found) > 6
        assert [path for path in found if path.lstat().st_mode & 0o007] == []
    finally:
        run.close()


def test_a_service_that_ends_too_often_is_said_and_the_daemon_ends_with_1(run: Run):
    run.wait_status(running=True)
    children = Path(f"/proc/{run.process.pid}/task/{run.process.pid}/children")
    began = time.monotonic()
    while time.monotonic() - began < PATIENCE_S:
        for child in children.read_text().split():
            with suppress(ProcessLookupError, FileNotFoundError):
                if b"fsw.service.process" in Path(f"/proc/{child}/cmdline").read_bytes():
                    os.kill(int(child), signal.SIGKILL)
        status = json.loads((run.state / "status.json").read_text())
        if status.get("processes", {}).get("service", {}).get("gave_up"):
            break
        time.sleep(0.2)
    assert status["processes"]["service"] == {"gave_up": True, "ends": 6}
    run.process.send_signal(signal.SIGTERM)
    assert run.process.wait(PATIENCE_S) == 1
    assert "too often: nothing is recorded until the next attempt" in run.errors.read_text()


def test_a_loop_that_waits_for_the_estimation_to_end_is_not_silent(run: Run):
    run.wait_status(running=True)
    estimation = child(run.process.pid, "estimation")
    os.kill(estimation, signal.SIGSTOP)
    run.process.send_signal(signal.SIGTERM)
    path, seen = run.state / "status.json", set[int]()
    began = time.monotonic()
    while len(seen) < 4 and run.process.poll() is None and time.monotonic() - began < PATIENCE_S:
        seen.add(json.loads(path.read_text())["t_ns"])
        time.sleep(0.1)
    os.kill(estimation, signal.SIGCONT)
    assert run.process.wait(PATIENCE_S) == 0
    assert len(seen) == 4
