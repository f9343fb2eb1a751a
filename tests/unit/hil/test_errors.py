"""A command whose reader has enough ends without a word."""

import os
import sys

import pytest

from hil.errors import explained


@pytest.mark.parametrize("lines", [1, 100_000], ids=["held back", "written at once"])
def test_a_closed_pipe_is_no_failure(lines, monkeypatch, capfd):
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as out:
        monkeypatch.setattr(sys, "stdout", out)
        assert explained(lambda: 0 * sys.stdout.write("name\n" * lines), 2, 1) == 0
    assert capfd.readouterr().err == ""
