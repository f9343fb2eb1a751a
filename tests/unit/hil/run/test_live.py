"""Reading what the system says of the processes of a run."""

import socket
import subprocess
import sys
from pathlib import Path

import pytest

from fsw.config.telemetry import TelemetryConfig
from hil.run.live import (
    STALE_NS,
    Announcement,
    LiveError,
    children,
    free_udp_ports,
    require_multicast,
    shown,
    trouble,
)
from hil.run.progress import describe

ESTIMATE = {
    "valid": True,
    "reason": "",
    "estimate": {"target": {"mass_kg": 400.0}},
    "sigma": {"target": {"mass_kg": 0.1}},
    "information_gained_nats": 90.0,
}


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


def test_a_port_of_the_link_that_is_in_use_is_named(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(LiveError, match=f"telemetry.port {port} .*in use"):
            Announcement(tmp_path, TelemetryConfig(port=port))
    Announcement(tmp_path, TelemetryConfig(port=port))


def test_the_meter_does_not_say_valid_of_a_run_that_is_not_recorded():
    recorder = {"failing": "/disk/recording_0001.mcap: No space left on device"}
    status = {"t_ns": 0, "estimate": ESTIMATE, "recorder": recorder}
    wrong = trouble(status, STALE_NS)
    assert "nothing is recorded" in wrong
    assert "No space left on device" in wrong
    assert "valid" not in describe(shown(status, wrong) or {})
    assert trouble({**status, "recorder": {"failing": ""}}, STALE_NS) == ""
    assert "valid" in describe(shown(status, "") or {})


def test_an_old_status_says_nothing_of_the_run():
    status = {"t_ns": 0, "estimate": ESTIMATE, "recorder": {"failing": ""}}
    assert "no status" in trouble(status, STALE_NS + 1)
    assert trouble(None, STALE_NS) == ""
