"""Reading what the system says of the processes of a run."""

from pathlib import Path

import pytest

from hil.run.live import LiveError, children, require_multicast


@pytest.mark.parametrize("error", [FileNotFoundError, ProcessLookupError])
def test_a_process_that_ends_while_it_is_read_has_no_children(monkeypatch, error):
    def ended(*_: object, **__: object) -> str:
        raise error

    monkeypatch.setattr(Path, "read_text", ended)
    assert children(1) == []


def test_a_group_that_cannot_be_joined_is_told_with_the_cure():
    require_multicast({"interface": "socketcan", "channel": "can0"})
    with pytest.raises(LiveError, match=r"ip route add 239.0.0.0/8 dev lo.*--fast"):
        require_multicast({"interface": "udp_multicast", "channel": "10.1.2.3"})  # is no group
