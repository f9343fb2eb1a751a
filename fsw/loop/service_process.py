"""The loop's end of the service process: starts it, watches it, starts it again when it dies."""

from __future__ import annotations

import fcntl
import os
import pickle
import subprocess
import sys
from pathlib import Path

from fsw.clock import Clock
from fsw.config import Config
from fsw.exchange.ring import RingReader, RingWriter
from fsw.exchange.ringlink import DOWN_BYTES, UP_BYTES, RingSink, commands_of
from fsw.messages import Event
from fsw.messages.commands import Command
from fsw.messages.errors import MEMORY_EXIT, PortError

LOCK_NAME = "loop.lock"
LOCK_WAIT_NS = 1_000_000_000  # for the kernel to be done with a loop that was killed
LOCK_POLL_NS = 20_000_000
MOST_RESTARTS = 5  # within RESTARTS_NS
RESTARTS_NS = 60_000_000_000
STALL_NS = 5_000_000_000  # a service that leaves the ring alone for so long is not healthy


def lock_state(directory: Path, clock: Clock) -> int:
    """Return the descriptor that holds a state directory for this loop.

    The kernel releases it when the loop has ended, however it ends.

    Raises
    ------
    PortError when another daemon keeps it.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        fd = os.open(directory / LOCK_NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise PortError(f"{directory}: {error.strerror or error}") from error
    deadline_ns = clock.now_ns() + LOCK_WAIT_NS
    while True:
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            if clock.now_ns() >= deadline_ns:
                os.close(fd)
                raise PortError(f"{directory}: another daemon is running on it") from error
            clock.sleep_until_ns(clock.now_ns() + LOCK_POLL_NS)
        else:
            return fd


class ServiceProcess:
    """The rings, the process at their other end, and what becomes of it."""

    def __init__(self, config: Config, clock: Clock) -> None:
        self._clock = clock
        self._down, self._up = RingWriter.create(DOWN_BYTES), RingWriter.create(UP_BYTES)
        self._config_fd = os.memfd_create("fsw-config")
        with os.fdopen(self._config_fd, "wb", closefd=False) as file:
            pickle.dump(config, file)
        self._deaths_ns: list[int] = []
        self._gave_up = False
        self._consumed = -1
        self._consumed_ns = clock.now_ns()
        self.sink = RingSink(self._down)
        self._commands = RingReader(os.dup(self._up.fd))
        self._process = self._start(resume=False)

    @property
    def pid(self) -> int:
        """Process identifier of the service."""
        return self._process.pid

    def commands(self) -> list[Command]:
        """Return the commands that have come from the service since the last call."""
        return commands_of(self._commands)

    def watch(self) -> bool:
        """Start the service again if it has died; return whether it is alive and at work."""
        now_ns = self._clock.now_ns()
        if self._gave_up:
            return False
        if self._process.poll() is not None:
            self._died(now_ns)
            return False
        consumed = self._down.consumed_bytes
        if consumed != self._consumed or not self._down.used_bytes:
            self._consumed, self._consumed_ns = consumed, now_ns
        return now_ns - self._consumed_ns < STALL_NS

    def wait(self, timeout_s: float) -> bool:
        """Wait for the service to write what is left; False when it does not end."""
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return False
        return True

    def _died(self, now_ns: int) -> None:
        status = self._process.returncode
        code = "SERVICE_MEMORY" if status == MEMORY_EXIT else "SERVICE_LOST"
        text = f"service process ended with {status}"
        recent = [t_ns for t_ns in self._deaths_ns if now_ns - t_ns < RESTARTS_NS]
        self._deaths_ns = [*recent, now_ns]
        self._gave_up = len(self._deaths_ns) > MOST_RESTARTS
        what = "too often: nothing is recorded" if self._gave_up else "started again"
        self.sink.put(Event(now_ns, "high", code, f"{text}; {what}"))
        if not self._gave_up:
            self._process = self._start(resume=True)

    def _start(self, *, resume: bool) -> subprocess.Popen[bytes]:
        down, up, config = self._down.fd, self._up.fd, self._config_fd
        command = [
            sys.executable,
            "-m",
            "fsw.service.process",
            "--down",
            str(down),
            "--up",
            str(up),
        ]
        command += ["--config", str(config), "--parent", str(os.getpid())]
        command += ["--resume"] if resume else []
        return subprocess.Popen(
            command,
            pass_fds=(down, up, config),
            stdin=subprocess.DEVNULL,
            start_new_session=True,
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        )
