"""Boot User-Mode Linux for one command.

The guest's first process is `guest.py`. Three serial lines connect the guest to this module: the
command's output, its errors, and a line of JSON objects with signals in and the end out.
"""

import json
import os
import selectors
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any

from hil.run.processes import tied
from hil.vcan import links, registers
from hil.vcan.job import (
    GRACE_S,
    NO_COMMAND,
    SIGNAL_BASE,
    TIMED_OUT,
    Job,
    VcanError,
    exit_status,
)

KERNEL = "linux.uml"
PACKAGES = {KERNEL: "user-mode-linux", "ip": "iproute2"}
MEMORY_MIB = 1024
BOOT_TIMEOUT_S = 120.0
CHUNK_BYTES = 65536
POLL_S = 0.1
LOG_CHARACTERS = 500
PRIORITY = 10  # of the guest's kernel in SCHED_FIFO: above ordinary processes, below urgent ones
NICE = -20  # of the guest's processes: before all other ordinary ones
ORDER_S = 0.2  # from one look at the guest's processes to the next
GUEST_TMPDIR = "/dev/shm"  # the host's file system cannot hold a socket
SYSTEM_PATH = "/usr/sbin:/usr/bin:/sbin:/bin"
GUEST = Path(__file__).with_name("guest.py")
FORWARDED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
KERNEL_ARGUMENTS = (
    f"mem={MEMORY_MIB}M",
    "root=/dev/root",
    "rootfstype=hostfs",
    "rootflags=/",
    "rw",
    "con=null",
    "con0=null,fd:1",
    "ssl=null",
    "quiet",
    "loglevel=3",
    "panic=-1",
    "noreboot",
)


def run(job: Job) -> int:
    """Run a command in a User-Mode Linux guest; return its exit status as a shell does.

    Raises
    ------
    VcanError if a Debian package is missing or the guest does not boot.
    """
    program = find(KERNEL)
    find("ip")
    with tempfile.TemporaryDirectory(prefix="vcan-") as name:
        machine = Machine(program, job, Path(name))
        try:
            return machine.serve()
        finally:
            machine.close()


def find(program: str) -> str:
    """Return the path of a program. Raises VcanError with the Debian package that has it."""
    path = shutil.which(program, path=f"{os.environ.get('PATH', '')}:{SYSTEM_PATH}")
    if path is None:
        package = PACKAGES[program]
        raise VcanError(f"needs Debian's {package}: no {program}; apt-get install {package}")
    return path


def memory_folder(fallback: Path) -> Path:
    """Return the folder of the guest's memory file: /dev/shm if large and executable."""
    shm = Path(GUEST_TMPDIR)
    try:
        state = os.statvfs(shm)
    except OSError:
        return fallback
    room = state.f_bavail * state.f_frsize
    usable = os.access(shm, os.W_OK) and not state.f_flag & os.ST_NOEXEC
    return shm if usable and room > MEMORY_MIB << 20 else fallback


class Machine:
    """One running guest, from boot to power-off."""

    def __init__(self, program: str, job: Job, folder: Path) -> None:
        self._folder = folder
        self._began_s = time.monotonic()
        self._timeout_s = job.timeout_s
        self._timed_out = False
        self._end: dict[str, Any] | None = None
        self._end_s = 0.0
        self._up = False
        self._pending = b""
        self._sent: list[int] = []
        self._realtime = False
        self._ordered_s = 0.0
        self._control, control = socket.socketpair()
        out, err = os.pipe(), os.pipe()
        far = (out[1], err[1], control.fileno())
        self._targets = {out[0]: sys.stdout.fileno(), err[0]: sys.stderr.fileno()}
        lines = (f"null,fd:{far[0]}", f"null,fd:{far[1]}", f"fd:{far[2]}")
        serial = [f"ssl{number}={channel}" for number, channel in enumerate(lines)]
        env = {"HOME": str(folder), "PATH": SYSTEM_PATH, "TMPDIR": str(memory_folder(folder))}
        if registers.are_too_large():
            env["LD_PRELOAD"] = str(registers.build(folder))
        with (
            (folder / "kernel.log").open("wb") as log,
            preferred(wanted=job.realtime) as realtime,
        ):
            start = write_job(folder, job, realtime=realtime)
            self._process = subprocess.Popen(
                tied([program, *KERNEL_ARGUMENTS, f"init={start}", *serial]),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                pass_fds=far,
                start_new_session=True,
                cwd=folder,
                env=env,
            )
        self._realtime = realtime
        if realtime:
            with suppress(OSError):  # not allowed, or a kernel that groups no sessions
                group = Path(f"/proc/{self._process.pid}/autogroup")
                group.write_text(str(NICE), encoding="ascii")
        control.close()
        for fd in far[:2]:
            os.close(fd)

    def serve(self) -> int:
        """Forward output and signals until the machine is off; return the exit status."""
        before = {number: signal.signal(number, self._forward) for number in FORWARDED}
        try:
            self._pump()
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
        return self._status()

    def close(self) -> None:
        """End every process of the machine in any state, and close the lines."""
        self.kill()
        self._process.wait()
        self._control.close()
        for fd in self._targets:
            os.close(fd)

    def kill(self) -> None:
        """Kill all processes of the machine."""
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)

    def send(self, number: int) -> None:
        """Send a signal to the command's process group."""
        self._sent.append(number)
        with suppress(OSError):  # the machine has ended
            self._control.sendall(json.dumps({"signal": number}).encode() + b"\n")

    def _forward(self, number: int, _frame: FrameType | None) -> None:
        """Forward a signal to the command; kill the machine at the second, or during the boot."""
        impatient = bool(self._sent) or not self._up
        self.send(number)
        if impatient:
            self.kill()

    def _pump(self) -> None:
        with selectors.DefaultSelector() as selector:
            for fd in (*self._targets, self._control.fileno()):
                selector.register(fd, selectors.EVENT_READ)
            while True:
                off = self._process.poll() is not None  # tested before the last read
                ready = [key.fd for key, _ in selector.select(POLL_S)]
                for fd in ready:
                    if not self._take(fd):
                        selector.unregister(fd)
                if off and not ready:
                    return
                self._watch_time()
                if self._realtime:
                    self._order()

    def _take(self, fd: int) -> bool:
        """Process the bytes of one line; return False at the end of the line."""
        try:
            data = os.read(fd, CHUNK_BYTES)
        except ConnectionResetError:
            return False
        if fd in self._targets:
            write_all(self._targets[fd], data)
        else:
            *lines, self._pending = (self._pending + data).split(b"\n")
            for message in map(json.loads, lines):
                self._up = True
                if "up" not in message:
                    self._end = message
                    self._end_s = time.monotonic()
        return bool(data)

    def _watch_time(self) -> None:
        """Apply the time limits of boot, command and power-off."""
        now_s = time.monotonic()
        if self._end is not None:
            if now_s > self._end_s + GRACE_S:
                self.kill()
        elif not self._up and now_s > self._began_s + BOOT_TIMEOUT_S:
            self.kill()
        elif self._timeout_s is not None:
            over_s = now_s - self._began_s - self._timeout_s
            if over_s > 2 * GRACE_S:
                self.kill()
            elif over_s > GRACE_S and signal.SIGKILL not in self._sent:
                self.send(signal.SIGKILL)
            elif over_s > 0 and not self._sent:
                self._timed_out = True
                self.send(signal.SIGTERM)

    def _order(self) -> None:
        """Let the guest's kernel interrupt the guest's processes, which are this machine's too.

        They start in SCHED_FIFO with the kernel's priority, which would not let the kernel obey
        its timer while one of them computes. They become ordinary processes of the highest
        preference: what they take does not count against this machine's limit of SCHED_FIFO.
        """
        now_s = time.monotonic()
        if now_s < self._ordered_s + ORDER_S:
            return
        self._ordered_s = now_s
        kernel = self._process.pid
        for pid in (int(name) for name in os.listdir("/proc") if name.isdecimal()):
            with suppress(OSError):  # ended
                if os.getsid(pid) == kernel != pid and is_equal(pid):
                    prefer(pid)

    def _status(self) -> int:
        if self._timed_out:
            return TIMED_OUT
        if self._end is None:
            if self._sent:
                return SIGNAL_BASE + self._sent[0]
            log = (self._folder / "kernel.log").read_text("utf-8", "replace").strip()
            raise VcanError(f"User-Mode Linux ended without a word: {log[-LOG_CHARACTERS:]}")
        if "failed" in self._end:
            if self._end["missing"]:
                sys.stderr.write(f"hil vcan: {self._end['failed']}\n")
                return NO_COMMAND
            raise VcanError(f"User-Mode Linux: {self._end['failed']}")
        code: int = self._end["returncode"]
        return exit_status(code)


@contextmanager
def preferred(*, wanted: bool) -> Iterator[bool]:
    """Let the block start processes in SCHED_FIFO on one processor; yield whether this holds.

    Every system call of a guest is a switch between two processes of the host. On one processor it
    costs half as much, and SCHED_FIFO keeps ordinary processes from interrupting.
    """
    processors, policy = os.sched_getaffinity(0), os.sched_getscheduler(0)
    parameters = os.sched_getparam(0)
    granted = wanted
    if wanted:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
            os.sched_setaffinity(0, {max(processors)})
        except OSError as error:
            sys.stderr.write(f"hil vcan: no real time: {error.strerror}\n")
            granted = False
    try:
        yield granted
    finally:
        if granted:
            os.sched_setaffinity(0, processors)
            os.sched_setscheduler(0, policy, parameters)


def is_equal(pid: int) -> bool:
    """Return whether a process still has the priority of the guest's kernel."""
    return (
        os.sched_getscheduler(pid) == os.SCHED_FIFO
        and os.sched_getparam(pid).sched_priority == PRIORITY
    )


def prefer(pid: int) -> None:
    """Make a process the first of the ordinary ones, not SCHED_FIFO; else lower its priority."""
    try:
        os.setpriority(os.PRIO_PROCESS, pid, NICE)
        os.sched_setscheduler(pid, os.SCHED_OTHER, os.sched_param(0))
    except PermissionError:
        os.sched_setscheduler(pid, os.SCHED_FIFO, os.sched_param(PRIORITY - 1))


def write_job(folder: Path, job: Job, *, realtime: bool) -> Path:
    """Write the job file and the first program of the guest; return the program's path."""
    umask = os.umask(0o077)
    os.umask(umask)
    document = {
        "argv": list(job.argv),
        "cwd": job.cwd,
        "env": {**job.env, "TMPDIR": GUEST_TMPDIR, "HIL_VCAN": "realtime" if realtime else "uml"},
        "umask": umask,
        "links": links.loopback() + links.added(),
        "realtime": realtime,
    }
    path = folder / "job.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    start = folder / "init"
    command = shlex.join([sys.executable, "-I", "-S", str(GUEST), str(path)])
    start.write_text(f"#!/bin/sh\nPATH={SYSTEM_PATH} exec {command}\n", encoding="utf-8")
    start.chmod(0o700)
    return start


def write_all(fd: int, data: bytes) -> None:
    """Write all data."""
    while data:
        data = data[os.write(fd, data) :]
