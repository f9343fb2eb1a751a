"""`hil vcan`: any command with a real vcan0 and vcan1, and the SocketCAN tests inside it."""

import hashlib
import json
import os
import re
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from hil.vcan import kernel, uml
from hil.vcan.job import VcanError

ROOT = Path(__file__).parents[3]


def can_be_had() -> bool:
    """Tell whether this kernel has CAN, or User-Mode Linux is installed."""
    try:
        return kernel.has_can() or bool(uml.find("linux.uml") and uml.find("ip"))
    except VcanError:
        return False


def needs_vcan(test):
    """Mark a test that runs a command below `hil vcan`."""
    reason = "needs user-mode-linux and iproute2: this kernel has no CAN"
    return pytest.mark.skipif(not can_be_had(), reason=reason)(test)


def vcan(*arguments, options=(), **settings):
    """Run a command below `hil vcan`."""
    return subprocess.run(
        [sys.executable, "-m", "hil", "vcan", *options, "--", *arguments],
        cwd=settings.pop("cwd", ROOT),
        env=os.environ | {"PYTHONPATH": str(ROOT)} | settings.pop("env", {}),
        capture_output=True,
        timeout=settings.pop("timeout", 240),
        check=False,
    )


SCRIPT = """
import json, os, socket, sys
with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as a:
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as b:
        a.bind(("vcan1",)); b.bind(("vcan1",))
        a.send(bytes(16))
        got = len(b.recv(72))
print(json.dumps([os.getcwd(), os.environ["FOR_TEST"], got, sys.argv[1:]]))
sys.stderr.write("apart")
sys.exit(7)
"""


@needs_vcan
def test_a_command_has_can_its_folder_its_environment_and_its_exit_status(tmp_path):
    done = vcan(
        *(sys.executable, "-c", SCRIPT, "--seed", "a b"), cwd=tmp_path, env={"FOR_TEST": "kept"}
    )
    assert done.returncode == 7, done.stderr
    assert json.loads(done.stdout) == [str(tmp_path), "kept", 16, ["--seed", "a b"]]
    assert done.stderr == b"apart"


@needs_vcan
def test_every_byte_of_both_outputs_passes_and_a_signal_is_the_shells_number():
    text = (
        "import hashlib, os, signal, sys\n"
        "data = os.urandom(1 << 20)\n"
        "sys.stdout.buffer.write(data)\n"
        "sys.stdout.flush()\n"
        "sys.stderr.write(hashlib.sha256(data).hexdigest())\n"
        "sys.stderr.flush()\n"
        "os.kill(os.getpid(), signal.SIGSEGV)\n"
    )
    done = vcan(sys.executable, "-c", text)
    assert len(done.stdout) == 1 << 20
    assert hashlib.sha256(done.stdout).hexdigest() == done.stderr.decode()
    assert done.returncode == 128 + signal.SIGSEGV


@needs_vcan
def test_a_command_that_ignores_the_end_of_its_time_is_killed():
    done = vcan("sh", "-c", "trap '' TERM; echo on; sleep 1000", options=("--timeout", "5"))
    assert done.returncode == 124
    assert done.stdout == b"on\n"


@needs_vcan
def test_an_interrupt_reaches_the_command_and_leaves_nothing(tmp_path):
    # short sleeps: a signal between the line and an endless wait would only be seen after it
    text = "import time\nprint('on', flush=True)\nwhile True: time.sleep(0.05)"
    with subprocess.Popen(
        [sys.executable, "-m", "hil", "vcan", "--", sys.executable, "-c", text],
        env=os.environ | {"PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as run:
        assert run.stdout is not None
        assert run.stdout.readline() == "on\n"
        assert kernel.has_can() or processes_of(tmp_path)
        run.send_signal(signal.SIGINT)
        _, err = run.communicate(timeout=120)
    assert run.returncode == 128 + signal.SIGINT
    assert "KeyboardInterrupt" in err
    assert not list(tmp_path.iterdir())
    assert not processes_of(tmp_path)


def processes_of(folder: Path) -> list[str]:
    """Return the command lines that name a folder: a machine's processes name its first program."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):
            found.append(path.read_text("utf-8", "replace"))
    return [line for line in found if str(folder) in line]


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.setattr(uml, "SYSTEM_PATH", "/nowhere")
    with pytest.raises(VcanError, match="apt-get install user-mode-linux"):
        uml.find("linux.uml")


@needs_vcan
def test_a_command_that_does_not_exist_is_told_in_one_line():
    done = vcan("no-such-command")
    assert done.returncode == 127
    assert done.stderr == b"hil vcan: no-such-command: No such file or directory\n"


@needs_vcan
@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_socketcan_suite_passes():
    addopts = "addopts=--import-mode=importlib --strict-markers --strict-config -ra"
    pytest_command = [sys.executable, "-m", "pytest", "-o", addopts, "-p", "no:xdist"]
    suite = ["-p", "no:cacheprovider", "tests/long/socketcan"]
    done = vcan(*pytest_command, *suite, options=("--realtime", "--timeout", "800"), timeout=850)
    output = done.stdout.decode()
    assert done.returncode == 0, f"{output}\n{done.stderr.decode()}"
    closing = output.strip().splitlines()[-1]
    assert re.search(r"=+ \d+ passed in [\d.]+s", closing), output  # nothing skipped
