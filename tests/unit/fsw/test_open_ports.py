"""Opening the configured devices: paths are taken from the configuration's folder."""

import os
import pty
from pathlib import Path

import pytest

from fsw.checks.configuration import missing_devices
from fsw.clock import MonotonicClock
from fsw.config import load
from fsw.exchange.sinks import NullSink
from fsw.loop.app import open_ports
from tests.conftest import ArmProject


def test_a_relative_serial_port_lies_beside_the_configuration(
    arm: ArmProject, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What `fsw check` looks for is what `fsw run` opens, from any working directory."""
    terminals = [fd for _ in range(2) for fd in pty.openpty()]
    (arm.folder / "imu").symlink_to(os.ttyname(terminals[1]))
    arm.data["imu"]["port"] = "imu"
    arm.data["star_tracker"]["port"] = os.ttyname(terminals[3])
    config = load(arm.write())
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    assert missing_devices(config) == []
    ports = open_ports(config, MonotonicClock(), NullSink())
    assert ports.imu is not None
    assert ports.star_tracker is not None
    ports.imu.close()
    ports.star_tracker.close()
    for port in ports.can.values():
        assert port is not None
        port.close()
    for fd in terminals:
        os.close(fd)


def test_a_url_is_opened_as_it_stands(arm: ArmProject) -> None:
    config = load(arm.write())
    assert config.device("socket://127.0.0.1:4000") == "socket://127.0.0.1:4000"
    assert Path(config.device("imu")) == arm.folder / "imu"
