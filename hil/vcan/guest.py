"""First process of the User-Mode Linux guest: CAN, then one command, then power off.

Runs on the bare interpreter (standard library only, nothing of this project), as process 1 and
user 0 of a kernel that has the host's files as its own. Serial lines lead out: ttyS0 and ttyS1
carry the command's standard output and error, ttyS2 one JSON object a line: signals in, end out.
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


def call(result: int, what: str) -> None:
    """Raise OSError when a libc call failed."""
    if result != 0:
        code = ctypes.get_errno()
        raise OSError(code, f"{what}: {os.strerror(code)}")


def prepare(links: str) -> None:
    """Mount the kernel's file systems, load the CAN modules, make the links."""
    libc = ctypes.CDLL(None, use_errno=True)
    for kind, where in MOUNTS:
        Path(where).mkdir(exist_ok=True)
        call(libc.mount(kind.encode(), where.encode(), kind.encode(), 0, None), f"mount {where}")
    folder = Path("/usr/lib/uml/modules") / platform.release()
    for name in MODULES:
        with (folder / name).open("rb") as file:
            call(libc.syscall(FINIT_MODULE, file.fileno(), b"", 0), name)
    subprocess.run(["ip", "-batch", "-"], input=links, text=True, check=True)


def raw_line(number: int) -> int:
    """Open a serial line that passes every byte as it is."""
    fd = os.open(f"/dev/ttyS{number}", os.O_RDWR | os.O_NOCTTY)
    tty.setraw(fd)
    return fd


def write_all(fd: int, data: bytes) -> None:
    """Write and wait until all is written."""
    while data:
        data = data[os.write(fd, data) :]


class Session:
    """One command, its two outputs, and the line that controls it."""

    def __init__(self, job: dict[str, Any], out: int, err: int, control: int) -> None:
        self._control, self._pending = control, b""
        self._selector = selectors.DefaultSelector()
        self._wake, wake_in = os.pipe()
        os.set_blocking(wake_in, False)
        signal.signal(signal.SIGCHLD, lambda _number, _frame: None)
        signal.set_wakeup_fd(wake_in, warn_on_full_buffer=False)
        self._pipes: dict[int, int] = {}  # descriptors the command writes to, and their targets
        ends = []
        for line in (out, err):
            read, write = os.pipe()
            os.set_blocking(read, False)
            self._pipes[read] = line
            ends.append(write)
        os.umask(job["umask"])
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
        """Serve until the command has ended and its output is out; return its return code."""
        while True:
            ready = {key.fd for key, _ in self._selector.select()}
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

    def _reap(self) -> int | None:
        """Accept every ended process; return the command's return code when it is among them."""
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
        """Pass on the output of the command; False when there is no more now."""
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
        """Send the command the signals asked for; power off when nobody is there to ask."""
        data = os.read(self._control, CHUNK_BYTES)
        if not data:
            power_off()
        *lines, self._pending = (self._pending + data).split(b"\n")
        for line in lines:
            with suppress(ProcessLookupError):
                os.killpg(self._command.pid, json.loads(line)["signal"])


def power_off() -> None:
    """End the machine; the kernel says nothing before it."""
    Path("/proc/sysrq-trigger").write_text("o", encoding="ascii")
    while True:
        signal.pause()


def main() -> None:
    """Serve the job of the file named on the command line; any failure is reported and ends it."""
    job = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    out, err, control = (raw_line(number) for number in range(3))
    end: dict[str, Any]
    try:
        prepare(job["links"])
        write_all(control, b'{"up": true}\n')
        end = {"returncode": Session(job, out, err, control).run()}
    except FileNotFoundError as error:
        missing = error.filename == job["argv"][0]
        end = {"failed": f"{error.filename}: {error.strerror}", "missing": missing}
    except Exception:  # noqa: BLE001  # whatever it is, the other side must hear of it
        end = {"failed": traceback.format_exc(limit=-3)}
    for fd in (out, err):
        termios.tcdrain(fd)
    os.sync()
    write_all(control, json.dumps(end).encode() + b"\n")
    termios.tcdrain(control)
    power_off()


if __name__ == "__main__":
    main()
