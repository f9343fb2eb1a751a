"""Run a command on this kernel's CAN, if the kernel has CAN."""

import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from hil.run.processes import tied
from hil.vcan import links
from hil.vcan.job import GRACE_S, NO_COMMAND, TIMED_OUT, Job, exit_status

NET = Path("/sys/class/net")
CLAIM = "\0inertia-daemon-hil-vcan"  # name of an abstract socket, without a file
FORWARDED = (signal.SIGTERM, signal.SIGHUP)


def has_can() -> bool:
    """Return whether raw CAN sockets can be opened here."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        return False
    return True


def missing_links() -> tuple[str, ...]:
    """Return the names of the links that do not exist or are down."""
    return tuple(name for name in links.NAMES if not _is_up(name))


def _is_up(name: str) -> bool:
    try:
        flags = int((NET / name / "flags").read_text(encoding="ascii"), 16)
    except OSError:
        return False
    return bool(flags & 1)  # IFF_UP


@contextmanager
def provided() -> Iterator[bool]:
    """Make missing links and remove these afterwards; yield whether all links are up."""
    if not has_can():
        yield False
        return
    made = tuple(name for name in missing_links() if not (NET / name).exists())
    if made and not _ip(links.added(made)):
        _ip(links.deleted(made))
        made = ()
    try:
        yield not missing_links()
    finally:
        if made:
            _ip(links.deleted(made))


@contextmanager
def claimed() -> Iterator[bool]:
    """Claim the links for this run alone; yield whether the claim holds and the links are up."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as claim:
        try:
            claim.bind(CLAIM)  # the kernel releases the claim when the process ends
        except OSError:
            yield False
            return
        with provided() as ready:
            yield ready


def _ip(lines: str) -> bool:
    try:
        done = subprocess.run(
            ["ip", "-force", "-batch", "-"],
            input=lines,
            text=True,
            capture_output=True,
            check=False,
        )
    except FileNotFoundError:
        return False
    return done.returncode == 0


def run(job: Job) -> int:
    """Run the command as a child; return its exit status as a shell does."""
    try:
        command = tied(job.argv, job.env)
        child = subprocess.Popen(command, cwd=job.cwd, env=job.env, stdin=subprocess.DEVNULL)
    except FileNotFoundError as error:
        sys.stderr.write(f"hil vcan: {error.filename}: {error.strerror}\n")
        return NO_COMMAND

    def forward(number: int, _frame: FrameType | None) -> None:
        child.send_signal(number)

    before = {number: signal.signal(number, forward) for number in FORWARDED}
    try:
        return exit_status(child.wait(job.timeout_s))
    except subprocess.TimeoutExpired:
        child.terminate()
        try:
            child.wait(GRACE_S)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
        return TIMED_OUT
    except KeyboardInterrupt:  # the child gets the terminal's signal, too
        return exit_status(child.wait())
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
