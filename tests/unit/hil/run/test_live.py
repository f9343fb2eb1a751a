"""Reading what the system says of the processes of a run."""

import json
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from mcap.writer import CompressionType, Writer

from fsw.config.telemetry import TelemetryConfig
from hil.run.live import (
    STALE_NS,
    Announcement,
    LiveError,
    children,
    estimate_by,
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


def test_a_recording_cut_at_any_byte_gives_what_is_before_the_cut(tmp_path: Path) -> None:
    path, cut = tmp_path / "whole.mcap", tmp_path / "cut.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1, compression=CompressionType.NONE)
        writer.start()
        channel = writer.register_channel("/estimate", "json", 0)
        for t_ns in (10, 20, 30):
            writer.add_message(channel, t_ns, json.dumps({"t_ns": t_ns}).encode(), t_ns)
        writer.finish()
    data = path.read_bytes()
    found = []
    for size in range(len(data)):
        cut.write_bytes(data[:size])
        try:
            found.append(estimate_by([cut], 25)["t_ns"])
        except LiveError:
            found.append(0)
    assert sorted(found) == found
    assert set(found) == {0, 10, 20}
