"""Everything that is started ends with its parent, however that ends: kill -9, interrupt."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from uuid import uuid4

import pytest

from hil.run.processes import tied

MARK = "HIL_TEST_MARK"
PATIENCE_S = 900.0  # a busy machine
ROOT = Path(__file__).parents[3]
CAMPAIGN = "level: device\nseeds: {first: 0, count: 40}\nscenarios: [target_leo]\n"
TESTS = """
import subprocess, sys, time

def test_starts_a_process_and_waits():
    subprocess.run([sys.executable, "-c", "import time; time.sleep(1000)", "left"])
"""
HIL = (sys.executable, "-m", "hil")
PYTEST = (sys.executable, "-m", "pytest", "-p", "no:cacheprovider", f"--rootdir={ROOT}")
DAEMON = ("fsw run", "fsw.estimation.process", "fsw.service.process")
# the command in a folder, and what is to be seen among its processes before it is killed
COMMANDS: dict[str, tuple[Callable[[Path], list[str]], tuple[str, ...]]] = {
    "run": (
        lambda folder: [*HIL, "run", "target_leo", "--json", "--out", str(folder / "run")],
        ("hil.devices", *DAEMON),
    ),
    "seeds": (
        lambda _: [*HIL, "seeds", "target_leo", "--jobs", "2"],
        ("hil run target_leo --json --seed 0", "hil run target_leo --json --seed 1"),
    ),
    "campaign": (
        lambda folder: [
            *(*HIL, "campaign", str(folder / "campaign.yaml")),
            *("--out", str(folder / "out")),
        ],
        ("spawn_main",),
    ),
    "soak": (
        lambda folder: [*HIL, "soak", "--jobs", "2", "--hours", "2", "--out", str(folder)],
        ("spawn_main",),
    ),
    "kills": (
        lambda folder: [*HIL, "kills", "--seed", "1", "--out", str(folder)],
        ("hil.devices", *DAEMON),
    ),
    "transfers": (
        lambda folder: [*HIL, "transfers", "--seed", "1", "--out", str(folder)],
        (*DAEMON, "-m ground"),
    ),
    "study": (
        lambda folder: [*HIL, "study", "methods", "--quick", "--out", str(folder)],
        ("spawn_main",),
    ),
    "tests": (
        lambda folder: [*PYTEST, "-n", "2", "-c", str(ROOT / "pyproject.toml"), str(folder)],
        ("time.sleep(1000)",),
    ),
}

INTERRUPTIONS: dict[str, Callable[[subprocess.Popen], None]] = {
    "control-c": lambda run: os.killpg(run.pid, signal.SIGINT),
    "terminated": lambda run: run.terminate(),
}


def marked(mark: str) -> dict[int, str]:
    """Return the command lines of all processes with a mark in their environment."""
    found = {}
    for place in Path("/proc").glob("[0-9]*"):
        try:
            environment = (place / "environ").read_bytes()
            line = (place / "cmdline").read_bytes()
        except (FileNotFoundError, ProcessLookupError, PermissionError):
            continue
        if f"{MARK}={mark}".encode() in environment.split(b"\0"):
            found[int(place.name)] = line.replace(b"\0", b" ").decode(errors="replace")
    return found


def until(condition: Callable[[], bool]) -> bool:
    """Wait for a condition; False when it does not come."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > deadline_s:
            return False
        time.sleep(0.1)
    return True


def seen(mark: str, wanted: tuple[str, ...]) -> bool:
    lines = marked(mark).values()
    return all(any(word in line for line in lines) for word in wanted)


@pytest.fixture(autouse=True)
def interruptible() -> Iterator[None]:
    """What is started takes Ctrl-C, also where these tests themselves were started without."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def short_path() -> Iterator[Path]:
    """A folder with a short name: the path of a socket below it is at most 93 bytes long."""
    with tempfile.TemporaryDirectory(prefix="left-", ignore_cleanup_errors=True) as name:
        yield Path(name)


@pytest.mark.slow
@pytest.mark.timeout(2000)
@pytest.mark.parametrize("name", COMMANDS)
def test_a_killed_command_leaves_no_process_behind(name, short_path):
    command, wanted = COMMANDS[name]
    (short_path / "campaign.yaml").write_text(CAMPAIGN)
    (short_path / "conftest.py").write_text("from tests.conftest import pytest_configure\n")
    (short_path / "test_left.py").write_text(TESTS)
    assert_nothing_left(command(short_path), wanted, short_path, lambda run: run.kill())


@pytest.mark.slow
@pytest.mark.timeout(2000)
@pytest.mark.parametrize("name", INTERRUPTIONS)
def test_an_interrupted_live_test_leaves_no_process_behind(name, short_path):
    """The tests themselves, while one of them has a daemon, its devices and a ground."""
    live = str(Path(__file__).with_name("test_transfers.py"))
    command = [*PYTEST, "-n", "2", "-c", str(ROOT / "pyproject.toml"), live]
    wanted = ("hil transfers", *DAEMON)
    assert_nothing_left(command, wanted, short_path, INTERRUPTIONS[name])


def assert_nothing_left(
    command: list[str],
    wanted: tuple[str, ...],
    folder: Path,
    interrupt: Callable[[subprocess.Popen], None],
) -> None:
    """Start a command, interrupt it when `wanted` is among its processes: all of them end."""
    mark = uuid4().hex
    log = folder / "command.log"
    with log.open("wb") as out:
        process = subprocess.Popen(
            command,
            cwd=ROOT,
            env=os.environ | {MARK: mark, "PYTHONPATH": str(ROOT)},
            stdout=out,
            stderr=out,
            start_new_session=True,
        )
    try:
        assert until(lambda: seen(mark, wanted) or process.poll() is not None), marked(mark)
        assert process.poll() is None, log.read_text()
        interrupt(process)
        process.wait()
        assert until(lambda: not marked(mark)), marked(mark)
    finally:
        for pid in marked(mark):
            os.kill(pid, signal.SIGKILL)


def test_what_is_tied_ends_with_the_process_that_started_it():
    text = (
        "import subprocess, sys; from hil.run.processes import tied;"
        "print(subprocess.Popen(tied(['sleep', '1000'])).pid, flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", text], stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT
    ) as parent:
        assert parent.stdout is not None
        child = os.pidfd_open(int(parent.stdout.readline()))
        parent.kill()
    assert until(lambda: ended(child))
    os.close(child)


def ended(process: int) -> bool:
    """Tell whether the process of a descriptor has ended."""
    try:
        signal.pidfd_send_signal(process, 0)
    except ProcessLookupError:
        return True
    return False


def test_what_is_tied_does_not_start_after_its_parent():
    command = tied(["echo", "started"])
    command[command.index(str(os.getpid()))] = "1"
    done = subprocess.run(command, capture_output=True, check=False)
    assert (done.returncode, done.stdout) == (1, b"")


def test_a_program_that_is_missing_is_named():
    with pytest.raises(FileNotFoundError, match="no-such-program"):
        tied(["no-such-program"])
