"""RESTART is refused where the daemon would not come back, or would come back without its link."""

import os
from collections.abc import Callable

import pytest
import yaml

from fsw.clock import MonotonicClock
from fsw.config import load
from fsw.config.overlay_file import with_overlays
from fsw.errors import CommandError
from fsw.exchange.ring import RingReader, RingWriter
from fsw.exchange.ringlink import commands_of
from fsw.messages.commands import Command, CommandName
from fsw.service.process import Service
from fsw.service.start_check import check_start
from tests.conftest import ArmProject

SDLS = {"tc_security": "sdls", "sdls": {"keys": [{"spi": 1, "file": "a.key"}]}}


@pytest.fixture
def flying(arm: ArmProject) -> ArmProject:
    """A project whose configuration and key are good."""
    (arm.folder / "a.key").write_bytes(bytes(range(32)))
    (arm.folder / "a.key").chmod(0o600)
    arm.data["telemetry"] = SDLS | {"port": 0}
    arm.write()
    return arm


def broken(arm: ArmProject, section: str, key: str, value: object) -> None:
    arm.data[section][key] = value
    arm.write()


FAULTS: dict[str, Callable[[ArmProject], object]] = {
    "rate_hz": lambda arm: broken(arm, "imu", "rate_hz", -5.0),
    "config.yaml": lambda arm: (arm.folder / "config.yaml").unlink(),
    "mapping": lambda arm: (arm.folder / "config.yaml").write_text("- 5"),
    "arm.urdf": lambda arm: (arm.folder / "arm.urdf").write_text("<robot"),
    "0600": lambda arm: (arm.folder / "a.key").chmod(0o644),
    "32 bytes": lambda arm: (arm.folder / "a.key").write_bytes(b"5"),
    "recorder.directory": lambda arm: broken(arm, "recorder", "directory", "."),
}


@pytest.mark.parametrize("word", FAULTS)
def test_a_start_that_would_end_or_be_deaf_is_named(flying: ArmProject, word: str):
    config = load(flying.folder / "config.yaml")
    check_start(config)
    FAULTS[word](flying)
    with pytest.raises(CommandError, match=word) as caught:
        check_start(config)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["overlay.yaml", "a + b overlay.yaml"])
def test_overlays_are_read_again_too(flying: ArmProject, name: str):
    overlay = flying.folder / name
    overlay.write_text("imu: {rate_hz: 250.0}\n")
    config = with_overlays(load(flying.folder / "config.yaml"), [overlay])
    check_start(config)
    overlay.write_text("imu: {rate_hz: 0.0}\n")
    with pytest.raises(CommandError, match=r"overlay\.yaml.*rate_hz"):
        check_start(config)


def test_the_service_passes_a_restart_on_only_where_the_start_would_succeed(flying: ArmProject):
    config = load(flying.folder / "config.yaml")
    down, found, up = (RingWriter.create(1 << 20) for _ in range(3))
    commands = RingReader(os.dup(up.fd))
    inbox = RingReader(os.dup(down.fd)), RingReader(os.dup(found.fd))
    service = Service(config, MonotonicClock(), *inbox, up, resume=False)
    good = (flying.folder / "config.yaml").read_text()
    (flying.folder / "config.yaml").write_text(yaml.safe_dump(flying.data | {"imu": {}}))
    assert service._forward(Command(name=CommandName.RESTART, id=7))
    (reply,) = service._answers
    assert not reply.accepted
    assert commands_of(commands) == []
    (flying.folder / "config.yaml").write_text(good)
    assert service._forward(Command(name=CommandName.RESTART, id=8))
    assert [command.id for command in commands_of(commands)] == [8]
