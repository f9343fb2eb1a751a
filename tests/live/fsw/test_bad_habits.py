"""The daemon as a careless operator starts it."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from fsw.exchange.recording import contents
from tests.conftest import ArmProject

PATIENCE_S = 90.0  # a busy machine
CLOSED = 'exec env --default-signal=HUP "$0" "$@" <&- >&- 2>&-'  # also where pytest ignores it


def wait_ticks(state: Path, process: subprocess.Popen[bytes]) -> dict:
    """The first status after a hundred ticks."""
    until_s = time.monotonic() + PATIENCE_S
    path = state / "status.json"
    while time.monotonic() < until_s and process.poll() is None:
        if path.exists() and (status := json.loads(path.read_text())).get("ticks", 0) > 100:
            return status
        time.sleep(0.05)
    raise TimeoutError(process.poll())


def test_without_streams_in_a_folder_of_others_until_the_terminal_closes(arm: ArmProject):
    folder = arm.folder / "of others"
    folder.mkdir()
    for name in ("json", "signal", "struct"):
        (folder / f"{name}.py").write_text("raise SystemExit('not the one that was meant')")
    command = str(Path(sys.executable).with_name("fsw"))
    process = subprocess.Popen(
        ["sh", "-c", CLOSED, command, "run", str(arm.write())],
        cwd=folder,
        env={"PATH": os.environ["PATH"], "LC_ALL": "C"},
    )
    try:
        status = wait_ticks(arm.folder / "state", process)
        process.send_signal(signal.SIGHUP)
        assert process.wait(PATIENCE_S) == 0
    finally:
        process.kill()
        process.wait()
    assert {name: own["ends"] for name, own in status["processes"].items()} == {
        "service": 0,
        "estimation": 0,
    }
    recording = contents(arm.folder / "recordings" / "recording_0001.mcap")
    assert not recording.truncated
