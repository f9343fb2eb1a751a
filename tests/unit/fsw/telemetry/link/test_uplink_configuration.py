"""`fsw check` reads keys and numbers of the authenticated uplink as the daemon will."""

from pathlib import Path

import pytest

from fsw.__main__ import main
from fsw.telemetry.link.sdls_numbers import NUMBERS_NAME
from tests.conftest import ArmProject

KEY = bytes(range(32))


@pytest.fixture
def secured(arm: ArmProject, monkeypatch) -> ArmProject:
    monkeypatch.delenv("CREDENTIALS_DIRECTORY", raising=False)
    use(arm, {"spi": 1, "file": "uplink.key"})
    keep(arm.folder / "uplink.key", KEY)
    return arm


def use(arm: ArmProject, *keys: dict) -> None:
    arm.data["telemetry"] = {"tc_security": "sdls", "sdls": {"keys": list(keys)}}


def keep(path: Path, key: bytes, mode: int = 0o600) -> None:
    path.write_bytes(key)
    path.chmod(mode)


def check(arm: ArmProject, capsys) -> tuple[int, str]:
    code = main(["check", str(arm.write())])
    out, err = capsys.readouterr()
    return code, out + err


def test_good_keys_pass_and_nothing_is_made(secured: ArmProject, capsys):
    code, told = check(secured, capsys)
    assert (code, "authenticated, SPI 1" in told) == (0, True)
    assert not (secured.folder / "state").exists()


@pytest.mark.parametrize(
    ("key", "mode", "word"),
    [(KEY, 0o644, "mode 0644"), (KEY[:31], 0o600, "32 bytes"), (None, 0, "No such file")],
)
def test_a_key_that_the_daemon_would_not_use_is_a_fault(
    secured: ArmProject, capsys, key, mode, word
):
    path = secured.folder / "uplink.key"
    path.unlink()
    if key is not None:
        keep(path, key, mode)
    code, told = check(secured, capsys)
    assert code == 2
    assert f"telemetry.sdls: {path}: " in told
    assert word in told


def test_one_key_in_two_slots_is_a_fault(secured: ArmProject, capsys):
    keep(secured.folder / "second.key", KEY)
    use(secured, {"spi": 1, "file": "uplink.key"}, {"spi": 2, "file": "second.key"})
    code, told = check(secured, capsys)
    assert (code, "another slot" in told) == (2, True)


def test_numbers_that_cannot_be_read_are_a_fault(secured: ArmProject, capsys):
    state = secured.folder / "state"
    state.mkdir()
    (state / NUMBERS_NAME).write_text("{")
    code, told = check(secured, capsys)
    assert (code, NUMBERS_NAME in told) == (2, True)
    assert (state / NUMBERS_NAME).read_text() == "{"


def test_a_credential_is_read_where_there_are_any_and_else_warned_of(
    secured: ArmProject, capsys, monkeypatch
):
    use(secured, {"spi": 1, "file": "uplink.key"}, {"spi": 2, "credential": "second"})
    code, told = check(secured, capsys)
    assert (code, "telemetry.sdls.keys.1.credential: 'second' was not read" in told) == (0, True)
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(secured.folder))
    assert check(secured, capsys)[0] == 2
    keep(secured.folder / "second", KEY[::-1])
    code, told = check(secured, capsys)
    assert (code, "was not read" in told) == (0, False)
