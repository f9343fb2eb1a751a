"""The daemon as real processes on terminals nobody writes to, and a client of its link."""

import os
import pty
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.link.packets import Decoder, Telemetry, telecommand_packet
from tests.conftest import ArmProject

PATIENCE_S = 120.0  # a busy machine
ENDS = ("completion_success", "completion_failure", "acceptance_failure")
MODES = {"SAFE": 1, "STANDBY": 2, "IDENTIFY": 3}


class Ground:
    """A client; `seal` makes of a packet what goes up."""

    def __init__(self, port: int, seal: Callable[[bytes], bytes] = bytes) -> None:
        self.link = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
        self._seal = seal
        self._buffer = b""
        self._decoder = Decoder()
        self._sequence = 0
        self.seen: list[Telemetry] = []

    def read(self) -> Telemetry:
        while len(self._buffer) < 6 or len(self._buffer) < self._length():
            data = self.link.recv(65536)
            if not data:
                raise EOFError
            self._buffer += data
        length = self._length()
        raw, self._buffer = self._buffer[:length], self._buffer[length:]
        self.seen.append(self._decoder.decode(raw))
        return self.seen[-1]

    def _length(self) -> int:
        return int.from_bytes(self._buffer[4:6], "big") + 7

    def until(self, what: str, found: Callable[[Telemetry], bool]) -> Telemetry:
        """Read until a packet is the one looked for."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            told = self.read()
            if found(told):
                return told
        raise TimeoutError(what)

    def wait(self, name: str, **values: Any) -> Telemetry:
        """Read until a packet of this name with these values comes."""
        return self.until(
            name,
            lambda told: (
                told.packet.name == name
                and all(told.values.get(key) == value for key, value in values.items())
            ),
        )

    def drain(self) -> None:
        """Read until the daemon closes the link."""
        with suppress(EOFError, ConnectionResetError):
            while True:
                self.read()

    def send(self, name: str, values: dict | None = None) -> int:
        packet = telecommand_packet(DICTIONARY.telecommand(name), values or {}, self._sequence)
        self.link.sendall(self._seal(packet))
        self._sequence += 1
        return self._sequence - 1

    def tell(self, name: str, values: dict | None = None) -> str:
        """Give a telecommand and return how it ended."""
        sequence = self.send(name, values)
        told = self.until(
            name,
            lambda told: (
                told.packet.name in ENDS and told.values["request_sequence"] & 0x3FFF == sequence
            ),
        )
        return told.packet.name

    def mode(self, wanted: str) -> Telemetry:
        return self.wait("health", mode=MODES[wanted])


class Run:
    """One daemon on terminals nobody writes to and a virtual bus; may be started again."""

    def __init__(self, arm: ArmProject, **telemetry: Any) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.state: Path = arm.folder / "state"
        self.grounds: list[Ground] = []
        self.terminals = [fd for _ in range(2) for fd in pty.openpty()]
        arm.data["imu"]["port"] = os.ttyname(self.terminals[1])
        arm.data["star_tracker"]["port"] = os.ttyname(self.terminals[3])
        settings = {"port": self.port, "housekeeping_interval_s": 0.2}
        arm.data["telemetry"] = settings | telemetry
        self.path = arm.write()
        self.process = self._start()

    def _start(self) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-m", "fsw", "run", str(self.path)],
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        )

    def connect(self, seal: Callable[[bytes], bytes] = bytes) -> Ground:
        deadline = time.monotonic() + PATIENCE_S
        while True:
            try:
                self.grounds.append(Ground(self.port, seal))
                return self.grounds[-1]
            except OSError:
                if time.monotonic() > deadline or self.process.poll() is not None:
                    raise
                time.sleep(0.05)

    def end(self) -> int:
        """End in order; return the exit code."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(PATIENCE_S)

    def kill(self) -> None:
        """Kill loop and service where they stand, and wait until both have gone."""
        process = f"/proc/{self.process.pid}"
        children = Path(f"{process}/task/{self.process.pid}/children").read_text().split()
        services = [os.pidfd_open(int(pid)) for pid in children]
        self.process.kill()
        for descriptor in services:
            signal.pidfd_send_signal(descriptor, signal.SIGKILL)
            assert select.select([descriptor], [], [], PATIENCE_S)[0]  # readable when it has ended
            os.close(descriptor)
        self.process.wait()

    def again(self) -> None:
        """Start once more on the same state."""
        self.process = self._start()

    def close(self) -> None:
        for ground in self.grounds:
            ground.link.close()
        if self.process.poll() is None:
            self.kill()
        for fd in self.terminals:
            os.close(fd)


@contextmanager
def running(arm: ArmProject, **telemetry: Any) -> Iterator[Run]:
    """Run a daemon for a block."""
    run = Run(arm, **telemetry)
    try:
        yield run
    finally:
        run.close()
