import errno
import os
import termios
from pathlib import Path

import pytest

from fsw.clock import MonotonicClock
from fsw.drivers.ports.serial_line import open_serial
from fsw.errors import PortError


def test_bytes_pass_both_ways_over_a_pseudo_terminal() -> None:
    device, host = os.openpty()
    clock = MonotonicClock()
    port = open_serial(os.ttyname(host), 921600, clock)
    os.close(host)
    try:
        assert port.read() == []
        sent = bytes(range(256)) * 3
        before_ns = clock.now_ns()
        os.write(device, sent)
        chunks = port.read()
        assert b"".join(c.data for c in chunks) == sent
        assert before_ns <= chunks[0].t_ns <= clock.now_ns()
        port.write(b"\x0a\x0d\x11\x13\xff")
        assert os.read(device, 64) == b"\x0a\x0d\x11\x13\xff"
        assert len(port.wake_fds()) == 1
        os.write(device, b"x")
        assert clock.sleep_until_ns(clock.now_ns() + 10**10, port.wake_fds()) is False
    finally:
        port.close()
        os.close(device)


def test_what_waited_before_opening_is_dropped() -> None:
    device, host = os.openpty()
    os.write(device, b"old\n")
    port = open_serial(os.ttyname(host), 115200, MonotonicClock())
    assert port.read() == []
    port.close()
    os.close(host)
    os.close(device)


def test_a_line_that_hangs_up_raises_a_port_error() -> None:
    device, host = os.openpty()
    path = os.ttyname(host)
    port = open_serial(path, 115200, MonotonicClock())
    os.close(host)
    os.close(device)
    with pytest.raises(PortError, match=path):
        port.read()
    port.close()


def test_a_line_that_cannot_be_opened_is_named(tmp_path: Path) -> None:
    path = tmp_path / "none"
    with pytest.raises(PortError, match=str(path)):
        open_serial(str(path), 115200, MonotonicClock())


def test_a_line_that_hangs_up_while_it_is_opened_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(_fd: int, _queue: int) -> None:
        raise termios.error(errno.EIO, "Input/output error")

    device, host = os.openpty()
    path = os.ttyname(host)
    monkeypatch.setattr(termios, "tcflush", gone)
    with pytest.raises(PortError, match=path):
        open_serial(path, 115200, MonotonicClock())
    os.close(host)
    os.close(device)
