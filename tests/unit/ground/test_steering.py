"""Reports that somebody on the way has forged do not steer the ground."""

from __future__ import annotations

import pytest

from ground.__main__ import main
from tests.support.fake_daemon import report
from tests.support.sealed_daemon import KEY, REPLAY, SealedDaemon


@pytest.fixture
def key_file(tmp_path):
    path = tmp_path / "uplink.key"
    path.write_bytes(KEY)
    path.chmod(0o600)
    return path


def run(daemon: SealedDaemon, key_file, *words: str) -> int:
    state = key_file.parent / "state"
    options = ["--port", str(daemon.port), "--key", str(key_file), "--state", str(state)]
    return main([*options, *words])


def forged(number: float):
    """Return a forger of REPLAY reports that name a number."""
    return lambda packet: [report("acceptance_failure", packet, error=REPLAY, error_value=number)]


def test_a_forged_replay_makes_no_command_run_twice(tmp_path, key_file, capsys):
    with SealedDaemon(tmp_path, forge=forged(5.0)) as daemon:
        assert run(daemon, key_file, "tc", "REC_START", "--timeout", "2") == 0
        assert len(daemon.executed) == 1
    assert capsys.readouterr().out.endswith("completed\n")


@pytest.mark.parametrize("number", [2.0**20, 2.0**47, 2.0**60, 1e300, -1.0])
def test_a_forged_replay_locks_nobody_out(tmp_path, key_file, number):
    with SealedDaemon(tmp_path, forge=forged(number)) as daemon:
        run(daemon, key_file, "tc", "PING", "--timeout", "0.5")
    with SealedDaemon(tmp_path) as daemon:
        assert run(daemon, key_file, "tc", "PING", "--timeout", "2") == 0


def test_what_was_refused_as_repeated_is_not_sent_again(tmp_path, key_file, capsys):
    with SealedDaemon(tmp_path) as daemon:
        for _ in range(3):
            assert run(daemon, key_file, "tc", "PING") == 0
        (tmp_path / "state").rename(tmp_path / "lost")
        assert run(daemon, key_file, "tc", "REC_START", "--timeout", "0.5") == 5
        assert len(daemon.executed) == 3
        told = capsys.readouterr()
        assert "not sent again" in told.err
        assert "number 3" in told.err
        assert run(daemon, key_file, "number", "3") == 0
        assert run(daemon, key_file, "tc", "REC_START") == 0
        assert len(daemon.executed) == 4


def test_a_frame_that_arrives_twice_has_one_effect_and_one_answer(tmp_path, key_file, capsys):
    with SealedDaemon(tmp_path, copies=2) as daemon:
        assert run(daemon, key_file, "tc", "REC_START") == 0
        assert len(daemon.executed) == 1
    assert capsys.readouterr().out.endswith("completed\n")


def test_numbers_are_shown_and_set_with_a_key_only(tmp_path, key_file, capsys):
    state = ["--state", str(tmp_path / "state")]
    assert main([*state, "number"]) == 2
    assert main([*state, "--key", str(key_file), "number", "40"]) == 0
    assert main([*state, "--key", str(key_file), "number"]) == 0
    assert capsys.readouterr().out == "40\n40\n"
