"""No restart, however it came about, opens an old number again."""

import errno
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from fsw.errors import ConfigError
from fsw.telemetry.link.sdls import RANDOM_BITS, RESERVE, Accepted, Association, FrameReceiver
from fsw.telemetry.link.sdls import FrameReject as Reason
from fsw.telemetry.link.sdls_numbers import NumberStore
from tests.support.sdls_sender import Sender

KEY = bytes(range(32))

CHILD = """
import os, signal, sys
from pathlib import Path
from fsw.telemetry.link.sdls import Accepted, Association, FrameReceiver
from fsw.telemetry.link.sdls_numbers import NumberStore

folder, frames, die_at, chance = Path(sys.argv[1]), sys.argv[2], sys.argv[3], int(sys.argv[4])
calls = 0

def die(place):
    global calls
    calls += place == die_at
    if place == die_at and calls == chance:
        os.kill(os.getpid(), signal.SIGKILL)

def wrapped(name, real):
    def call(*arguments, **keywords):
        die("before " + name)
        result = real(*arguments, **keywords)
        die("after " + name)
        return result
    return call

def torn_pwrite(descriptor, data, offset):
    global calls
    calls += die_at == "in pwrite"
    if die_at == "in pwrite" and calls == chance:
        real_pwrite(descriptor, data[:len(data) // 3], offset)
        os.kill(os.getpid(), signal.SIGKILL)
    return real_pwrite(descriptor, data, offset)

real_pwrite = os.pwrite
os.pwrite = wrapped("pwrite", torn_pwrite)
os.fdatasync = wrapped("fdatasync", os.fdatasync)
receiver = FrameReceiver(
    [Association(spi=7, key=bytes(range(32)))], NumberStore(folder / "numbers.json"),
    spacecraft_id=42, virtual_channel=3, window=64)
for line in Path(frames).read_text().split():
    outcome = receiver.receive(bytes.fromhex(line))
    die("before use")
    if isinstance(outcome, Accepted):
        descriptor = os.open(folder / "effects", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.write(descriptor, f"{outcome.number}\\n".encode())
        os.close(descriptor)
    die("after use")
"""
PLACES = [
    "before pwrite",
    "in pwrite",
    "after pwrite",
    "before fdatasync",
    "after fdatasync",
    "before use",
    "after use",
]


def run_child(folder: Path, numbers: range, die_at: str, chance: int) -> int:
    """Feed frames to a process of its own that may be killed; return its exit code."""
    sender = Sender(key=KEY)
    frames = folder / "frames"
    frames.write_text("\n".join(sender.frame(b"\x01", number).hex() for number in numbers))
    command = [sys.executable, "-c", CHILD, str(folder), str(frames), die_at, str(chance)]
    return subprocess.run(command, timeout=60, check=False, env=os.environ).returncode


def effects(folder: Path) -> list[int]:
    path = folder / "effects"
    return [int(word) for word in path.read_text().split()] if path.exists() else []


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("chance", [1, 2, 3])
def test_killed_anywhere_no_frame_has_an_effect_twice(tmp_path, place, chance):
    killed = run_child(tmp_path, range(80), place, chance)
    assert killed == -signal.SIGKILL
    once = effects(tmp_path)
    assert run_child(tmp_path, range(160), "", 0) == 0
    in_all = effects(tmp_path)
    assert len(in_all) == len(set(in_all)), "a frame had an effect twice"
    assert in_all[: len(once)] == once
    assert set(range(110, 160)) <= set(in_all), "new ones are taken"


def uplink(store: NumberStore) -> FrameReceiver:
    return FrameReceiver(
        [Association(spi=7, key=KEY)], store, spacecraft_id=42, virtual_channel=3, window=64
    )


def test_a_crash_skips_no_more_numbers_than_were_kept_ahead(tmp_path):
    path = tmp_path / "numbers.json"
    first = uplink(NumberStore(path))
    for number in range(40):
        first.receive(Sender(key=KEY).frame(b"\x01", number))
    after_crash = uplink(NumberStore(path)).next_number(7)
    assert after_crash is not None
    assert 40 <= after_crash <= 40 + RESERVE


def test_an_orderly_end_skips_none(tmp_path):
    store = NumberStore(tmp_path / "numbers.json")
    first = uplink(store)
    first.receive(Sender(key=KEY).frame(b"\x01", 20))
    first.settle()
    again = uplink(NumberStore(tmp_path / "numbers.json"))
    assert again.next_number(7) == 21
    assert not isinstance(again.receive(Sender(key=KEY).frame(b"\x01", 20)), Accepted)


def test_a_number_that_cannot_be_kept_is_not_used(tmp_path, monkeypatch):
    store = NumberStore(tmp_path / "numbers.json")

    def full(_descriptor):
        raise OSError(errno.ENOSPC, "No space left on device")

    store.prepare()
    with monkeypatch.context() as broken:
        broken.setattr(os, "fdatasync", full)
        outcome = uplink(store).receive(Sender(key=KEY).frame(b"\x01", 0))
        assert outcome.reason is Reason.NOT_KEPT
        assert "No space left" in outcome.text
    assert isinstance(uplink(store).receive(Sender(key=KEY).frame(b"\x01", 0)), Accepted)


def test_numbers_of_an_earlier_version_open_nothing(tmp_path):
    (tmp_path / "numbers.json").write_text("{}")
    with pytest.raises(ConfigError, match="earlier version"):
        NumberStore(tmp_path / "numbers")


def damaged_variants() -> list[bytes]:
    good = {"keys": {"ab": {"floor": 7, "retired": False}}, "crc32": 1}
    return [b"", b"{", b"[]", json.dumps(good).encode(), b'{"keys": {}}', b"\xff\xfe"]


@pytest.mark.parametrize("content", damaged_variants())
def test_a_damaged_file_opens_nothing(tmp_path, content):
    path = tmp_path / "numbers.json"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"numbers\.json"):
        NumberStore(path)


def test_a_flipped_digit_is_noticed(tmp_path):
    path = tmp_path / "numbers.json"
    uplink(NumberStore(path)).receive(Sender(key=KEY).frame(b"\x01", 33))
    path.write_text(path.read_text().replace(str(50 << RANDOM_BITS), str(10 << RANDOM_BITS)))
    with pytest.raises(ConfigError, match="CRC"):
        NumberStore(path)
