"""Recorded commands that this software never wrote end in one line."""

from types import SimpleNamespace

import pytest

from fsw.errors import ConfigError
from fsw.exchange.recording import RecordedMessage
from offline.replay import _plan


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"[]",
        b"5",
        b"[" * 100_000,
        b'{"command": "end"}',
        b'{"command": "end", "next_window": 1e999}',
        b'{"command": "reset", "args": {}, "next_window": 1}',
        b'{"command": "reset", "id": "x", "args": {}, "next_window": 1}',
        b'{"command": "reset", "id": 1, "args": 5, "next_window": 1}',
        b'{"command": "reset", "id": 1, "args": {}}',
    ],
)
def test_a_command_of_wrong_content_ends_in_one_line(data: bytes):
    planned = SimpleNamespace(dispatcher=SimpleNamespace(plan=lambda *_: None))
    with pytest.raises(ConfigError, match="not a command of this software") as error:
        _plan(planned, [RecordedMessage(7, (0,), "/tc", data)], None)
    assert len(str(error.value)) < 400
