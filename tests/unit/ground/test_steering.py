"""Reports that somebody on the way has forged do not steer the ground."""

import pytest

from fsw.telemetry.link.sdls import Association, Role
from fsw.telemetry.link.sdls_numbers import NumberStore
from fsw.telemetry.link.sdls_sender import FrameSender
from ground.__main__ import main
from tests.support.fake_daemon import report
from tests.support.keys import write_key
from tests.support.sealed_daemon import KEY, REPLAY, SealedDaemon


@pytest.fixture
def key_file(tmp_path):
    return write_key(tmp_path / "uplink.key", KEY)


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


@pytest.mark.parametrize("number", [2.0**20, 2.0**47, 2.0**60, 1e300, -1.0, float("nan")])
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
    assert main([*state, "--key", str(key_file), "number", str(2**48)]) == 2
    (path,) = (tmp_path / "state").glob("*.json")
    path.write_text("{")
    assert main([*state, "--key", str(key_file), "number"]) == 2
    assert "damaged" in capsys.readouterr().err


TELEMETRY = bytes(range(100, 132))


@pytest.fixture
def tm_key(tmp_path):
    return write_key(tmp_path / "tm.key", TELEMETRY)


def frame_sender(folder, key=TELEMETRY) -> FrameSender:
    return FrameSender(
        Association(spi=2, key=key, role=Role.TELEMETRY),
        NumberStore(folder / "tm_numbers.json"),
        spacecraft_id=42,
        virtual_channel=0,
        report=lambda *_: None,
        unix_s=lambda: 0.0,
    )


def test_a_ground_that_has_lost_its_numbers_finds_them_by_authentic_reports(
    tmp_path, key_file, tm_key, capsys
):
    words = ("--tm-key", str(tm_key), "tc", "REC_START")
    with SealedDaemon(tmp_path, seal=frame_sender(tmp_path).seal) as daemon:
        assert run(daemon, key_file, "number", "5000") == 0
        daemon.skip_to(5000)
        assert run(daemon, key_file, *words) == 0
        first = len(daemon.executed)
        (tmp_path / "state").rename(tmp_path / "lost")
        assert run(daemon, key_file, *words) == 0
        assert len(daemon.executed) == first + 1, (
            "the ping that asked had no effect, and came first"
        )
        assert run(daemon, key_file, "number") == 0
    assert capsys.readouterr().out.endswith("completed\n5002\n")


def test_numbers_too_high_are_set_back_by_an_authentic_report_and_nothing_is_sent_again(
    tmp_path, key_file, tm_key, capsys
):
    words = ("--tm-key", str(tm_key), "tc", "REC_START")
    with SealedDaemon(tmp_path, seal=frame_sender(tmp_path).seal) as daemon:
        run(daemon, key_file, "number", str(2**40))
        assert run(daemon, key_file, *words) == 5
        assert daemon.executed == []
        assert "not sent again" in capsys.readouterr().err
        assert run(daemon, key_file, *words) == 0
        assert len(daemon.executed) == 1


def test_forged_reports_do_not_reach_a_ground_that_opens_frames(tmp_path, key_file, tm_key, capsys):
    (tmp_path / "other").mkdir()
    other = frame_sender(tmp_path / "other", bytes(32))

    def forge(packet):
        refused = report("acceptance_failure", packet, error=REPLAY, error_value=2.0**40)
        wrong = report("acceptance_failure", packet, error=7)
        return [refused, wrong, other.seal(refused)]

    with SealedDaemon(tmp_path, forge=forge, seal=frame_sender(tmp_path).seal) as daemon:
        for _ in range(2):
            assert run(daemon, key_file, "--tm-key", str(tm_key), "tc", "REC_START") == 0
        assert len(daemon.executed) == 3, "two, and the ping of the first connection"
    told = capsys.readouterr()
    assert "acceptance failure" not in told.out
    assert "not authentic" in told.err


def test_a_frame_that_somebody_doubles_is_executed_and_reported_once(
    tmp_path, key_file, tm_key, capsys
):
    with SealedDaemon(tmp_path, copies=2, seal=frame_sender(tmp_path).seal) as daemon:
        assert run(daemon, key_file, "--tm-key", str(tm_key), "tc", "REC_START") == 0
        assert run(daemon, key_file, "--tm-key", str(tm_key), "tc", "REC_STOP") == 0
        assert len(daemon.executed) == 3
    assert capsys.readouterr().out.count("completed") == 2
