"""The systemd unit, judged by systemd's own tools, and what the daemon tells systemd."""

import os
import re
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from fsw.__main__ import main
from fsw.config import load
from fsw.errors import ConfigError
from fsw.loop.notify import Notifier
from fsw.service.install_service import UNIT_NAME, unit_text
from tests.conftest import ArmProject

ANALYZE = shutil.which("systemd-analyze")
needs_systemd = pytest.mark.skipif(ANALYZE is None, reason="needs systemd")
MOST_EXPOSED = 40  # of 100, systemd's own sum; a unit without any protection has 96


def analyze(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([str(ANALYZE), *arguments], capture_output=True, text=True, check=False)


def installed(arm: ArmProject, folder: Path) -> Path:
    """The unit as the command writes it, for a daemon that is there."""
    path = arm.write()
    config = load(path)
    command = folder / "fsw"
    command.write_text("#!/bin/sh\n")
    command.chmod(0o755)
    unit = folder / UNIT_NAME
    unit.write_text(unit_text(config, [path], "daemon", command))
    return unit


@needs_systemd
def test_systemd_finds_nothing_wrong_with_the_unit(arm: ArmProject, tmp_path: Path) -> None:
    unit = installed(arm, tmp_path)
    found = analyze("verify", "--man=no", str(unit))
    ours = [line for line in found.stderr.splitlines() if UNIT_NAME in line]
    assert (found.returncode, ours) == (0, []), found.stderr
    unit.write_text(unit.read_text().replace("WatchdogSec=10", "WatchdogSec=soon"))
    assert UNIT_NAME in analyze("verify", "--man=no", str(unit)).stderr  # it does look


@needs_systemd
def test_the_unit_is_hardened(arm: ArmProject, tmp_path: Path) -> None:
    unit = installed(arm, tmp_path)
    found = analyze("security", "--offline=true", f"--threshold={MOST_EXPOSED}", str(unit))
    assert found.returncode == 0, found.stdout[-1000:]


def test_the_unit_asks_for_what_the_loop_needs_and_no_more(arm: ArmProject, tmp_path: Path) -> None:
    keys = dict(re.findall(r"^(\w+)=(.*)$", installed(arm, tmp_path).read_text(), flags=re.M))
    assert keys["Type"] == "notify"
    assert int(keys["WatchdogSec"]) >= 4  # strokes come once a second
    assert keys["CapabilityBoundingSet"] == ""
    assert "AmbientCapabilities" not in keys
    assert keys["User"] != "root"
    assert (keys["LimitMEMLOCK"], keys["NoNewPrivileges"]) == ("infinity", "true")
    assert {"StartLimitBurst", "StartLimitIntervalSec", "Restart"} <= set(keys)
    folders = keys["ReadWritePaths"].split()
    assert folders == [f"-{arm.folder}/{name}" for name in ("state", "recordings")]


def test_the_command_writes_it_and_says_what_is_left(
    arm: ArmProject, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "units"
    folder.mkdir()
    arguments = ["install-service", str(arm.write()), "--user", "robot"]
    assert main([*arguments, "--directory", str(folder)]) == 0
    text = (folder / UNIT_NAME).read_text()
    assert f"ExecStart={Path(sys.executable).with_name('fsw')} run {arm.folder}" in text
    told = capsys.readouterr().out
    assert "useradd --system --groups dialout robot" in told
    assert f"install -d -o robot -g robot {arm.folder}/state {arm.folder}/recordings" in told
    assert main([*arguments, "--directory", str(tmp_path / "absent")]) == 1


def test_overlays_stand_in_the_unit_with_their_whole_paths(
    arm: ArmProject, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = arm.write()
    monkeypatch.chdir(arm.folder)
    Path("state.yaml").write_text("service: {state_directory: elsewhere}\n")
    words = ["--overlay", "state.yaml", "--directory", str(tmp_path)]
    assert main(["install-service", str(path), *words]) == 0
    text = (tmp_path / UNIT_NAME).read_text()
    assert f" run {path} --overlay {arm.folder}/state.yaml\n" in text
    assert f"ReadWritePaths=-{arm.folder}/elsewhere " in text


@pytest.mark.parametrize("user", ["", "a b", "a%b", "x\ny"])
def test_a_name_that_would_change_the_unit_is_refused(arm: ArmProject, user: str) -> None:
    path = arm.write()
    with pytest.raises(ConfigError, match="is not possible in a systemd unit"):
        unit_text(load(path), [path], user, Path("/usr/bin/fsw"))


@pytest.mark.parametrize("abstract", [False, True])
def test_systemd_is_told_in_datagrams(tmp_path: Path, abstract: bool) -> None:
    name = f"fsw-{os.getpid()}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(("\0" if abstract else "") + name)
        notifier = Notifier({"NOTIFY_SOCKET": ("@" if abstract else "") + name})
        assert notifier.send("READY=1", "STATUS=x")
        assert listener.recv(100) == b"READY=1\nSTATUS=x"
        notifier.close()


def test_without_systemd_nothing_is_told_and_nothing_fails(tmp_path: Path) -> None:
    assert not Notifier({}).send("READY=1")
    deaf = Notifier({"NOTIFY_SOCKET": str(tmp_path / "nobody")})
    assert not deaf.send("READY=1")
    deaf.close()
