"""Reading what the system says of the processes of a run."""

from pathlib import Path

import pytest

from hil.run.live import children


@pytest.mark.parametrize("error", [FileNotFoundError, ProcessLookupError])
def test_a_process_that_ends_while_it_is_read_has_no_children(monkeypatch, error):
    def ended(*_: object, **__: object) -> str:
        raise error

    monkeypatch.setattr(Path, "read_text", ended)
    assert children(1) == []
