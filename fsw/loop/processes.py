"""The two other processes as the loop sees them: it starts, watches and restarts them."""

import fcntl
import os
import subprocess
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from fsw.clock import Clock
from fsw.config import Config
from fsw.errors import MEMORY_EXIT, PortError
from fsw.exchange.ring import RingReader, RingWriter
from fsw.exchange.ringlink import (
    DOWN_BYTES,
    TO_ESTIMATION,
    TO_SERVICE,
    UP_BYTES,
    RingSink,
    commands_of,
    hand_down,
)
from fsw.exchange.sinks import Fanout, Sink
from fsw.exchange.tied import module_command
from fsw.loop.loop import Loop
from fsw.messages import Event
from fsw.messages.commands import Code, Command, Reply

LOCK_NAME = "loop.lock"
LOCK_WAIT_NS = 1_000_000_000  # for the kernel to release the lock of a killed loop
LOCK_POLL_NS = 20_000_000
MOST_RESTARTS = 5  # within RESTARTS_NS
RESTARTS_NS = 60_000_000_000
STALL_NS = 5_000_000_000  # a process that reads nothing of its ring for this long is not healthy


def lock_state(directory: Path, clock: Clock) -> int:
    """Lock a state directory for this loop; return the descriptor that holds the lock.

    The kernel releases the lock when the loop ends, also when it is killed.

    Raises
    ------
    PortError when another daemon holds the lock, or the directory cannot be used.
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


Say = Callable[[str, Mapping[str, object]], None]


def say_nothing(line: str, status: Mapping[str, object]) -> None:
    """Do nothing."""


class Child:
    """A process at the other end of a ring: started, watched and started again when it has ended.

    Parameters
    ----------
    name : `service` or `estimation`, as in the names of its events
    without : words for the event after too many ends: the work that is no longer done
    module : Python module that the process runs
    arguments : command line arguments of the module
    fds : descriptors that the process inherits
    inbox : the ring that the process reads
    sink : receives an event whenever the process has ended
    say : writes a line to standard error and values into the status file, without waiting
    """

    def __init__(
        self,
        name: str,
        module: str,
        without: str,
        arguments: Sequence[str],
        fds: Sequence[int],
        inbox: RingWriter,
        sink: Sink,
        clock: Clock,
        say: Say,
    ) -> None:
        self._say = say
        self._name, self._module, self._without, self._sink = name, module, without, sink
        self._arguments, self._fds, self._inbox, self._clock = arguments, fds, inbox, clock
        self._cpus = os.sched_getaffinity(0)  # all CPUs of the loop before it is pinned to one
        self._deaths_ns: list[int] = []
        self.gave_up = False  # waits for RESTARTS_NS until it is tried again
        self.ends = 0  # number of unexpected ends
        self._consumed, self._consumed_ns = -1, clock.now_ns()
        self.is_stalled = False  # reads nothing of its ring
        self._process = self._start(resume=False)

    @property
    def pid(self) -> int:
        """Process identifier."""
        return self._process.pid

    def watch(self) -> bool:
        """Start the process again if it has ended; return whether it runs and reads its ring."""
        now_ns = self._clock.now_ns()
        if self.gave_up:
            if now_ns - self._deaths_ns[-1] >= RESTARTS_NS:
                self.gave_up = False
                self._process = self._start(resume=True)
            return False
        if self._process.poll() is not None:
            self._died(now_ns)
            return False
        consumed = self._inbox.consumed_bytes
        if consumed != self._consumed or not self._inbox.used_bytes:
            self._consumed, self._consumed_ns = consumed, now_ns
        is_stalled = now_ns - self._consumed_ns >= STALL_NS
        if is_stalled and not self.is_stalled:
            text = f"{self._name} process {self.pid} has read nothing for {STALL_NS / 1e9:g} s"
            self._say(f"{text}: {self._without} while it hangs", {})
        self.is_stalled = is_stalled
        return not is_stalled

    def wait(self, timeout_s: float) -> bool:
        """Wait at most `timeout_s` [s] for the end; return whether the process ended in order."""
        return self.has_ended(timeout_s) and self._process.returncode == 0

    def has_ended(self, timeout_s: float) -> bool:
        """Wait at most `timeout_s` [s] for the end; return whether the process has ended."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout_s)
        return self._process.returncode is not None

    def summary(self) -> dict[str, object]:
        """Return whether the process is at work, and how often it has ended, as plain values."""
        return {"gave_up": self.gave_up, "ends": self.ends}

    def kill(self) -> None:
        """Kill the process and wait for its end."""
        self._process.kill()
        self._process.wait()

    def _died(self, now_ns: int) -> None:
        status = self._process.returncode
        code = "MEMORY" if status == MEMORY_EXIT else "LOST"
        recent = [t_ns for t_ns in self._deaths_ns if now_ns - t_ns < RESTARTS_NS]
        self._deaths_ns = [*recent, now_ns]
        self.ends += 1
        self.gave_up = len(self._deaths_ns) > MOST_RESTARTS
        again = f"{self._without} until the next attempt in {RESTARTS_NS / 1e9:g} s"
        what = f"too often: {again}" if self.gave_up else "started again"
        text = f"{self._name} process ended with {status}; {what}"
        self._sink.put(Event(now_ns, "high", f"{self._name.upper()}_{code}", text))
        if self.gave_up:
            self._say(text, {"processes": {self._name: self.summary()}})
        else:
            self._process = self._start(resume=True)

    def _start(self, *, resume: bool) -> subprocess.Popen[bytes]:
        command = [*module_command(self._module), *self._arguments]
        process = subprocess.Popen(
            [*command, *(["--resume"] if resume else [])],
            pass_fds=self._fds,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        )
        os.sched_setaffinity(process.pid, self._cpus)
        return process


class Processes:
    """The service and estimation processes, and the rings between them and the loop.

    Parameters
    ----------
    since_ns : the estimation ignores checkpoints older than this time [ns]; 0: it uses all
    say : writes a line to standard error and values into the status file, without waiting
    """

    def __init__(self, config: Config, clock: Clock, since_ns: int, say: Say = say_nothing) -> None:
        down, found = RingWriter.create(DOWN_BYTES), RingWriter.create(DOWN_BYTES)
        up, self._stream = RingWriter.create(UP_BYTES), RingWriter.create(DOWN_BYTES)
        wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        config_fd = hand_down(config)
        self._commands, self._clock = RingReader(os.dup(up.fd)), clock
        self._to_estimation = RingSink(self._stream, TO_ESTIMATION, wake)
        self._to_service = RingSink(down, TO_SERVICE)
        self.sink = Fanout(self._to_estimation, self._to_service)
        self._told_lost = 0
        common = ["--config", str(config_fd), "--parent", str(os.getpid())]
        self.service = Child(
            "service",
            "fsw.service.process",
            "nothing is recorded",
            ["--down", str(down.fd), "--found", str(found.fd), "--up", str(up.fd), *common],
            (down.fd, found.fd, up.fd, config_fd),
            down,
            self._to_service,
            clock,
            say,
        )
        own = ["--ring", str(self._stream.fd), "--wake", str(wake), "--down", str(found.fd)]
        self.estimation = Child(
            "estimation",
            "fsw.estimation.process",
            "nothing is estimated",
            [*own, "--since", str(since_ns), *common],
            (self._stream.fd, wake, found.fd, config_fd),
            self._stream,
            self._to_service,
            clock,
            say,
        )

    @property
    def gave_up(self) -> bool:
        """Whether a process ended so often that its next attempt waits."""
        return self.service.gave_up or self.estimation.gave_up

    def summary(self) -> dict[str, object]:
        """Return the state of both processes as plain values."""
        return {"service": self.service.summary(), "estimation": self.estimation.summary()}

    def deadline_ns(self) -> int:
        """Return when the next window closes [ns]; 0 until the estimation has reported the time."""
        return self._stream.notes[0]

    def commands(self) -> list[Command]:
        """Return the commands received from the service since the last call."""
        return commands_of(self._commands)

    def submit(self, command: Command, loop: Loop) -> None:
        """Pass a command to the loop; reply QUEUE_FULL if it does not reach the estimation."""
        dropped = self._stream.dropped
        loop.submit(command)
        if self.estimation.gave_up or self._stream.dropped > dropped:
            name, text = str(command.name), "the estimation does not receive it"
            code = Code.QUEUE_FULL
            self._to_service.put(
                Reply(id=command.id, command=name, accepted=False, code=code, text=text)
            )

    def watch(self) -> bool:
        """Start ended processes again; return whether both are healthy."""
        watched = [self.service.watch(), self.estimation.watch()]
        return all(watched)

    def report_lost(self) -> None:
        """Report the traffic that was lost since the last report."""
        lost = self._to_estimation.lost
        if lost > self._told_lost and not self.estimation.gave_up:
            text = f"{lost - self._told_lost} frames and chunks lost between loop and estimation"
            self._to_service.put(Event(self._clock.now_ns(), "high", "ESTIMATION_DROPS", text))
        self._told_lost = lost

    def settle(self, seconds: int, report: Callable[[], None]) -> None:
        """Wait until the estimation has processed its traffic and ended; kill it after `seconds`.

        `report` is called each second, so that nobody believes that the loop has died.
        """
        self._to_estimation.close()
        if self.estimation.gave_up:
            return
        for _ in range(seconds):
            if self.estimation.has_ended(1.0):
                return
            report()
        self.estimation.kill()
