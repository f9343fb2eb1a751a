"""Progress on a terminal is one line; elsewhere one line per stage."""

import contextlib
import fcntl
import os
import pty
import struct
import sys
import termios

import pytest

from offline.progress import CLEAR, Progress


def test_a_terminal_has_one_line_that_is_rewritten_and_cleared(monkeypatch):
    near, far = pty.openpty()
    fcntl.ioctl(far, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 40, 0, 0))
    with os.fdopen(far, "w") as terminal:
        monkeypatch.setattr(sys, "stderr", terminal)
        with Progress("identify") as tell:
            tell("iteration 1: " + 40 * "x")
            tell("warning: stays")
            tell("iteration 2")
        monkeypatch.undo()
    shown = b""
    with contextlib.suppress(OSError):  # of a terminal whose other end is closed
        while part := os.read(near, 4096):
            shown += part
    os.close(near)
    first, warning, second, end = shown.decode().split(CLEAR)[1:]
    assert first == ("fsw: identify: iteration 1: " + 40 * "x")[:39]
    assert warning == "fsw: identify: warning: stays\r\n"
    assert (second, end) == ("fsw: identify: iteration 2", "")


def test_elsewhere_a_stage_is_one_line(capsys: pytest.CaptureFixture[str]):
    with Progress("identify") as tell:
        for k in range(100):
            tell(f"fused: iteration {k}: step {10.0**-k:.1e} sigma")
        tell("drawing")
    first, last = capsys.readouterr().err.splitlines()
    assert first == "fsw: identify: fused: iteration 0: step 1.0e+00 sigma"
    assert last == "fsw: identify: drawing"
