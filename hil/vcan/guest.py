"""First process of the User-Mode Linux guest: set up CAN, run one command, power off.

The program uses only the standard library. It is process 1 and user 0 of a kernel whose root file
system is the host's. Serial lines connect it to the host: ttyS0 and ttyS1 carry the command's
standard output and error; ttyS2 carries JSON objects, one a line: signals in, the end out.
"""

import ctypes
import json
import os
import platform
import selectors
import signal
import subprocess
import sys
import termios
import time
import traceback
import tty
from contextlib import suppress
from pathlib import Path
from typing import Any

FINIT_MODULE = 313  # x86-64
MODULES = (
    "kernel/net/can/can.ko",
    "kernel/net/can/can-raw.ko",
    "kernel/drivers/net/can/dev/can-dev.ko",
    "kernel/drivers/net/can/vcan.ko",
    "kernel/drivers/net/can/vxcan.ko",
)
MOUNTS = (
    ("proc", "/proc"),
    ("sysfs", "/sys"),
    ("devpts", "/dev/pts"),
    ("tmpfs", "/dev/shm"),
)
CHUNK_BYTES = 65536
KERNEL_THREADS = ("kworker", "ksoftirqd")
KERNEL_PRIORITY = 45  # of SCHED_FIFO: between the loop of `hil run` (50) and its devices (40)
ORDER_S = 1.0  # from one look at the kernel's threads to the next


def call(result: int, what: str) -> None:
    """Raise OSError if the result of a libc call is not 0."""
    if result != 0:
        code = ctypes.get_errno()
        raise OSError(code, f"{what}: {os.strerror(code)}")


def prepare(links: str, *, realtime: bool) -> None:
    """Mount file systems, load the CAN modules, and run `ip -batch` with the lines `links`.

    Parameters
    ----------
    realtime : let SCHED_FIFO take all of the processor; by default the kernel keeps 50 ms a second
    """
    libc = ctypes.CDLL(None, use_errno=True)
    for kind, where in MOUNTS:
        Path(where).mkdir(exist_ok=True)
        call(libc.mount(kind.encode(), where.encode(), kind.encode(), 0, None), f"mount {where}")
    folder = Path("/usr/lib/uml/modules") / platform.release()
    for name in MODULES:
        with (folder / name).open("rb") as file:
            call(libc.syscall(FINIT_MODULE, file.fileno(), b"", 0), name)
    subprocess.run(["ip", "-batch", "-"], input=links, text=True, check=True)
    if realtime:
        Path("/proc/sys/kernel/sched_rt_runtime_us").write_text("-1", encoding="ascii")


def serve_first(known: set[str]) -> None:
    """Give the kernel's threads that carry bytes and frames priority over computing processes.

    A kworker carries the bytes of a terminal to its reader, ksoftirqd frames to sockets. Both
    are ordinary processes, which never run while one in SCHED_FIFO computes; a reader, however
    urgent, waits for them.

    Parameters
    ----------
    known : numbers of processes that were checked before; extended
    """
    for name in os.listdir("/proc"):
        if not name.isdecimal() or name in known:
            continue
        known.add(name)
        with suppress(OSError):  # ended
            if (Path("/proc") / name / "comm").read_text("ascii").startswith(KERNEL_THREADS):
                os.sched_setscheduler(int(name), os.SCHED_FIFO, os.sched_param(KERNEL_PRIORITY))


def raw_line(number: int) -> int:
    """Open a serial line in raw mode, which changes no byte; return the descriptor."""
    fd = os.open(f"/dev/ttyS{number}", os.O_RDWR | os.O_NOCTTY)
    tty.setraw(fd)
    return fd


def write_all(fd: int, data: bytes) -> None:
    """Write all data; wait until they are written."""
    while data:
        data = data[os.write(fd, data) :]


class Session:
    """One command, its standard output and error, and the control line."""

    def __init__(self, job: dict[str, Any], out: int, err: int, control: int) -> None:
        self._control, self._pending = control, b""
        self._selector = selectors.DefaultSelector()
        self._wake, wake_in = os.pipe()
        os.set_blocking(wake_in, False)
        signal.signal(signal.SIGCHLD, lambda _number, _frame: None)
        signal.set_wakeup_fd(wake_in, warn_on_full_buffer=False)
        self._pipes: dict[int, int] = {}  # pipes of the command's output: read end to serial line
        ends = []
        for line in (out, err):
            read, write = os.pipe()
            os.set_blocking(read, False)
            self._pipes[read] = line
            ends.append(write)
        os.umask(job["umask"])
        self._realtime: bool = job["realtime"]
        self._looked_at: set[str] = set()
        self._order_s = time.monotonic()  # of the next look at the kernel's threads
        self._command = subprocess.Popen(
            job["argv"],
            cwd=job["cwd"],
            env=job["env"],
            stdin=subprocess.DEVNULL,
            stdout=ends[0],
            stderr=ends[1],
            start_new_session=True,
        )
        for end in ends:
            os.close(end)
        for fd in (self._wake, control, *self._pipes):
            self._selector.register(fd, selectors.EVENT_READ)

    def run(self) -> int:
        """Serve until the command has ended and its output is copied; return its return code."""
        while True:
            ready = {key.fd for key, _ in self._selector.select(self._wait_s())}
            for pipe in ready & self._pipes.keys():
                self._copy(pipe)
            if self._control in ready:
                self._obey()
            if self._wake in ready:
                os.read(self._wake, CHUNK_BYTES)
                code = self._reap()
                if code is not None:
                    for pipe in list(self._pipes):
                        while self._copy(pipe):
                            pass
                    return code

    def _wait_s(self) -> float | None:
        """Look at the kernel's threads if it is time; return the time to the next look [s]."""
        if not self._realtime:
            return None
        now_s = time.monotonic()
        if now_s >= self._order_s:
            serve_first(self._looked_at)
            self._order_s = now_s + ORDER_S
        return self._order_s - now_s

    def _reap(self) -> int | None:
        """Reap all ended processes; return the command's return code, or None if it runs."""
        while True:
            try:
                pid, status = os.waitpid(-1, os.WNOHANG)
            except ChildProcessError:
                return None
            if pid == 0:
                return None
            if pid == self._command.pid:
                return os.waitstatus_to_exitcode(status)

    def _copy(self, pipe: int) -> bool:
        """Copy output of the command to its line; return False if no output waits."""
        if pipe not in self._pipes:
            return False
        try:
            data = os.read(pipe, CHUNK_BYTES)
        except BlockingIOError:
            return False
        if data:
            write_all(self._pipes[pipe], data)
            return True
        self._selector.unregister(pipe)
        del self._pipes[pipe]
        return False

    def _obey(self) -> None:
        """Send the requested signals to the command; power off if the host is gone."""
        data = os.read(self._control, CHUNK_BYTES)
        if not data:
            power_off()
        *lines, self._pending = (self._pending + data).split(b"\n")
        for line in lines:
            with suppress(ProcessLookupError):
                os.killpg(self._command.pid, json.loads(line)["signal"])


def power_off() -> None:
    """Power the machine off without kernel messages; never return."""
    Path("/proc/sysrq-trigger").write_text("o", encoding="ascii")
    while True:
        signal.pause()


def main() -> None:
    """Run the job of the file on the command line; report the end or a failure, power off."""
    job = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    out, err, control = (raw_line(number) for number in range(3))
    end: dict[str, Any]
    try:
        prepare(job["links"], realtime=job["realtime"])
        write_all(control, b'{"up": true}\n')
        end = {"returncode": Session(job, out, err, control).run()}
    except FileNotFoundError as error:
        missing = error.filename == job["argv"][0]
        end = {"failed": f"{error.filename}: {error.strerror}", "missing": missing}
    except Exception:  # noqa: BLE001  # the host must get every failure
        end = {"failed": traceback.format_exc(limit=-3)}
    for fd in (out, err):
        termios.tcdrain(fd)
    os.sync()
    write_all(control, json.dumps(end).encode() + b"\n")
    termios.tcdrain(control)
    power_off()


if __name__ == "__main__":
    main()
