"""Authenticated telecommands between real processes: what was sent once is never taken again."""

import subprocess
import sys
from itertools import count

import pytest

from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.link.packets import Telemetry
from tests.conftest import ArmProject
from tests.support.keys import write_key
from tests.support.live_daemon import PATIENCE_S, Ground, Run, running
from tests.support.sdls_sender import Sender, with_fecf

KEY = bytes(range(32))
FIRST = 20  # the ground's own command takes the numbers before


class Recorder:
    """Seals packets and keeps the frames, as somebody who listens would."""

    def __init__(self) -> None:
        self._sender, self._numbers = Sender(key=KEY, spi=1, virtual_channel=0), count(FIRST)
        self.frames: list[bytes] = []

    def __call__(self, packet: bytes) -> bytes:
        self.frames.append(self._sender.frame(packet, next(self._numbers)))
        return self.frames[-1]

    def skip_to(self, number: int) -> None:
        self._numbers = count(number)


def sent_again(ground: Ground, data: bytes) -> Telemetry:
    """Send bytes and return how they were refused."""
    ground.link.sendall(data)
    return ground.until(
        "a refusal", lambda told: told.packet.name in ("acceptance_failure", "acceptance_success")
    )


def assert_replays_are_refused(run: Run, recorder: Recorder) -> None:
    ground = run.connect(recorder)
    ground.mode("STANDBY")  # as SET_MODE, which is among the frames, has left it
    told = {}
    for frame in recorder.frames:
        told = sent_again(ground, frame).values
        assert told["error"] == Error.REPLAY
    assert not any(told.packet.name == "alive" for told in ground.seen)
    recorder.skip_to(int(told["error_value"]))
    assert ground.tell("PING") == "completion_success"
    ground.link.close()


@pytest.fixture
def run(arm: ArmProject):
    write_key(arm.folder / "uplink.key", KEY)
    keys = [{"spi": 1, "file": "uplink.key"}]
    with running(arm, tc_security="sdls", sdls={"keys": keys, "window": 64}) as run:
        yield run


def test_sealed_telecommands_act_once_whatever_dies(run: Run, arm: ArmProject):
    recorder = Recorder()
    ground = run.connect(recorder)
    ground.mode("IDENTIFY")
    words = ["--key", arm.folder / "uplink.key", "--state", arm.folder / "ground"]
    words += ["--spi", "1", "--port", str(run.port)]
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-m", "ground", *words, "tc", "PING", "--timeout", str(PATIENCE_S)],
            capture_output=True,
            text=True,
            timeout=2 * PATIENCE_S,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
    assert ground.tell("PING") == "completion_success"
    assert ground.tell("SET_MODE", {"mode": "STANDBY"}) == "completion_success"
    ground.mode("STANDBY")
    accepted = ground.wait("link").values["sdls_accepted"]
    assert accepted == 4
    refused = sent_again(ground, recorder.frames[0]).values
    assert (refused["error"], refused["error_value"]) == (Error.REPLAY, FIRST + 2)
    frame = recorder.frames[1]
    for at in range(len(frame) - 2):  # every byte
        ground.link.sendall(with_fecf(frame[:at] + bytes((frame[at] ^ 1,)) + frame[at + 1 : -2]))
    ground.link.sendall(bytes(2048))  # a length that was tampered with waits for no more
    told = ground.until(
        "the tampered",
        lambda told: told.packet.name == "link" and told.values["sdls_failed"] >= len(frame) - 20,
    )
    assert told.values["sdls_accepted"] == accepted
    ground.link.close()
    run.kill()
    run.again()
    assert_replays_are_refused(run, recorder)
    assert run.end() == 0
    run.again()
    assert_replays_are_refused(run, recorder)
    assert run.end() == 0
