"""The daemon as real processes, commanded over TCP."""

import os
import pty
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress

import pytest

from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.packets import Decoder, Telemetry, telecommand_packet
from tests.conftest import ArmProject

pytestmark = pytest.mark.live

PATIENCE_S = 60.0


class Ground:
    """A client in clear."""

    def __init__(self, port: int) -> None:
        self.link = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
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

    def wait(self, name: str, **values) -> Telemetry:
        """Read until a packet of this name with these values comes."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            told = self.read()
            fits = all(told.values.get(key) == value for key, value in values.items())
            if told.packet.name == name and fits:
                return told
        raise TimeoutError(name)

    def drain(self) -> None:
        """Read until the daemon closes the link."""
        with suppress(EOFError, ConnectionResetError):
            while True:
                self.read()

    def send(self, name: str, values: dict | None = None) -> int:
        packet = telecommand_packet(DICTIONARY.telecommand(name), values or {}, self._sequence)
        self.link.sendall(packet)
        self._sequence += 1
        return self._sequence - 1

    def tell(self, name: str, values: dict | None = None) -> str:
        """Give a telecommand and return how it ended."""
        sequence = self.send(name, values)
        ends = ("completion_success", "completion_failure", "acceptance_failure")
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            told = self.read()
            if told.packet.name in ends and told.values["request_sequence"] & 0x3FFF == sequence:
                return told.packet.name
        raise TimeoutError(name)

    def mode(self, wanted: str) -> Telemetry:
        return self.wait("health", mode={"SAFE": 1, "STANDBY": 2, "IDENTIFY": 3}[wanted])


class Run:
    """One daemon on terminals nobody writes to and a virtual bus."""

    def __init__(self, arm: ArmProject) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.state = arm.folder / "state"
        self.grounds: list[Ground] = []
        self.terminals = [fd for _ in range(2) for fd in pty.openpty()]
        arm.data["imu"]["port"] = os.ttyname(self.terminals[1])
        arm.data["star_tracker"]["port"] = os.ttyname(self.terminals[3])
        arm.data["telemetry"] = {"port": self.port, "housekeeping_interval_s": 0.2}
        self.path = arm.write()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "fsw", "run", str(self.path)],
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        )

    def connect(self) -> Ground:
        deadline = time.monotonic() + PATIENCE_S
        while True:
            try:
                self.grounds.append(Ground(self.port))
                return self.grounds[-1]
            except OSError:
                if time.monotonic() > deadline or self.process.poll() is not None:
                    raise
                time.sleep(0.05)

    def close(self) -> None:
        for ground in self.grounds:
            ground.link.close()
        self.process.kill()
        self.process.wait()
        for fd in self.terminals:
            os.close(fd)


@pytest.fixture
def run(arm: ArmProject):
    run = Run(arm)
    yield run
    run.close()


def test_a_daemon_is_commanded_over_its_link_and_starts_again_when_told(run: Run):
    ground = run.connect()
    ground.mode("IDENTIFY")
    assert ground.tell("PING") == "completion_success"
    assert any(told.packet.name == "alive" for told in ground.seen)
    assert ground.tell("SETTLE_ESTIMATOR") == "completion_success"
    assert ground.tell("REC_STOP") == "completion_success"
    assert ground.wait("recorder").values["recording"] == 0
    assert ground.tell("REC_START") == "completion_success"
    ground.send("ENABLE_SET", {"sid": 20})
    assert ground.wait("science").packet.apid == 102
    assert ground.tell("RUN_BATCH", {"method": "FUSED", "unknown": 0, "last_s": 0.0}) == (
        "completion_failure"  # no window yet
    )
    assert ground.tell("SET_MODE", {"mode": "STANDBY"}) == "completion_success"
    ground.mode("STANDBY")
    before = ground.wait("link").values["boot_count"]
    assert ground.tell("RESTART", {"key": 0xB007}) == "completion_success"
    ground.drain()
    again = run.connect()
    told = again.mode("STANDBY").values  # as it was
    assert (told["boot_count"], told["reset_cause"]) == (before + 1, 2)
    run.process.send_signal(signal.SIGTERM)
    assert run.process.wait(PATIENCE_S) == 0
