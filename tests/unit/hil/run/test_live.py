"""Reading what the system says of the processes of a run."""

import socket
import subprocess
import sys
from pathlib import Path

import pytest

from hil.run.live import LiveError, children, free_udp_ports, require_multicast


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


def test_a_port_is_no_other_bench_s_before_it_is_opened(monkeypatch):
    """Two benches that draw one number: the second, a process of its own, draws again."""
    code = "from hil.run.live import free_udp_ports; print(*free_udp_ports(2), flush=True); input()"
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        taken = [int(word) for word in other.stdout.readline().split()]
        drawn = iter([*taken, 40_001])

        class Drawn(socket.socket):
            def getsockname(self):
                return "127.0.0.1", next(drawn)

        monkeypatch.setattr(socket, "socket", Drawn)
        assert len(set(taken)) == 2
        assert free_udp_ports(1) == [40_001]
        other.communicate("\n")
    drawn = iter(taken[:1])
    assert free_udp_ports(1) == taken[:1]  # let go with its process
