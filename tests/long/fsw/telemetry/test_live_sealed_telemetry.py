"""Sealed telemetry between real processes: commands, files, a change of keys, a kill."""

import os
import socket
import subprocess
import sys
from contextlib import ExitStack

import pytest

from tests.conftest import ArmProject
from tests.support.keys import write_key
from tests.support.live_daemon import PATIENCE_S, Run, running

KEYS = {"a.key": bytes(range(32)), "b.key": bytes(range(1, 33)), "look.key": bytes(range(2, 34))}
TM = bytes(range(3, 35))


@pytest.fixture
def run(arm: ArmProject):
    for name, key in {**KEYS, "tm.key": TM}.items():
        write_key(arm.folder / name, key)
    keys = [
        {"spi": 1, "file": "a.key"},
        {"spi": 3, "file": "b.key"},
        {"spi": 5, "file": "look.key", "role": "look"},
        {"spi": 2, "file": "tm.key", "role": "telemetry"},
    ]
    with running(arm, tc_security="sdls", sdls={"keys": keys}) as run:
        yield run


@pytest.fixture
def closing():
    with ExitStack() as stack:
        yield stack


def ground(arm: ArmProject, run: Run, *words: str, key: str = "a.key", spi: int = 1):
    """Run the ground's own command."""
    options = ["--port", str(run.port), "--key", key, "--spi", str(spi), "--tm-key", "tm.key"]
    return subprocess.run(
        [sys.executable, "-m", "ground", *options, "--state", "ground", *words],
        cwd=arm.folder,
        capture_output=True,
        text=True,
        timeout=2 * PATIENCE_S,
        check=False,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )


def test_the_ground_works_through_sealed_telemetry(run: Run, arm: ArmProject, closing: ExitStack):
    patience = ("--timeout", str(PATIENCE_S))
    run.connect().link.close()  # it is up
    address = ("127.0.0.1", run.port)
    idle = [closing.enter_context(socket.create_connection(address)) for _ in range(4)]
    done = ground(arm, run, "tc", "PING", *patience)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "alive" in done.stdout
    raw = idle[0].recv(1000)
    assert raw[0] >> 4 == 0xC, "frames"
    done = ground(arm, run, "tc", "REC_STOP", *patience, key="look.key", spi=5)
    assert done.returncode == 3
    assert "NOT_AUTHORISED" in done.stdout

    write_key(arm.folder / "a.key", bytes(range(60, 92)))
    write_key(arm.folder / "tm.key", bytes(range(90, 122)))
    refused = ground(arm, run, "tc", "PING", "--timeout", "3")
    assert refused.returncode in (1, 5), "the daemon still has the old keys"
    write_key(arm.folder / "tm.key", TM)
    assert ground(arm, run, "tc", "PING", *patience, key="b.key", spi=3).returncode == 0
    write_key(arm.folder / "tm.key", bytes(range(90, 122)))
    loaded = ground(arm, run, "tc", "LOAD_KEYS", *patience, key="b.key", spi=3)
    assert loaded.returncode == 0, loaded.stdout + loaded.stderr
    assert ground(arm, run, "tc", "PING", *patience).returncode == 0

    (arm.folder / "up.bin").write_bytes(bytes(range(256)) * 20)
    for words in (("put", "up.bin"), ("get", "files/up.bin", "down.bin")):
        done = ground(arm, run, "file", *patience, *words)
        assert done.returncode == 0, done.stdout + done.stderr
    assert (arm.folder / "down.bin").read_bytes() == (arm.folder / "up.bin").read_bytes()

    run.kill()
    run.again()
    run.connect().link.close()
    done = ground(arm, run, "tc", "PING", *patience)
    assert done.returncode in (0, 5), done.stdout + done.stderr
    done = ground(arm, run, "tc", "PING", *patience)
    assert done.returncode == 0, done.stdout + done.stderr
    log = "".join(path.read_text(errors="replace") for path in run.state.rglob("*.json*"))
    for key in (*KEYS.values(), TM):
        assert key.hex() not in log
    assert run.end() == 0
