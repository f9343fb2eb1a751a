"""The wish not to sleep deeply as the kernel reads it: a 32-bit number while the file is open."""

import os
import struct
from pathlib import Path

import pytest

from fsw.scheduler import realtime


@pytest.fixture
def device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "cpu_dma_latency"
    monkeypatch.setattr(realtime, "LATENCY_DEVICE", str(path))
    return path


def test_the_wish_is_written_as_one_number_and_the_file_stays_open(device: Path) -> None:
    device.touch()
    fd = realtime.keep_awake(300)
    assert struct.unpack("=i", device.read_bytes()) == (300,)
    assert os.readlink(f"/proc/self/fd/{fd}") == str(device)
    os.close(fd)


@pytest.mark.usefixtures("device")
def test_a_kernel_without_the_file_is_told() -> None:
    with pytest.raises(FileNotFoundError, match="cpu_dma_latency"):
        realtime.keep_awake(0)


def test_a_file_that_refuses_the_wish_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(realtime, "LATENCY_DEVICE", "/dev/full")
    before = sorted(os.listdir("/proc/self/fd"))
    with pytest.raises(OSError, match="No space left"):
        realtime.keep_awake(0)
    assert sorted(os.listdir("/proc/self/fd")) == before
