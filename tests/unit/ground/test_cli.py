"""The command line against a stand-in for the daemon: what is printed, and exit codes."""

import json

import pytest

from ground.__main__ import main
from tests.support.fake_daemon import OUTSIDE, FakeDaemon, completed, packet, report


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    """A home of its own: the command history is kept there."""
    monkeypatch.setenv("HOME", str(tmp_path))
    return tmp_path


def run(daemon: FakeDaemon, *words: str) -> int:
    return main(["--port", str(daemon.port), *words])


def test_a_ping_is_followed_to_its_end(capsys):
    def answer(tc):
        accepted, started, done = completed(tc)
        return [accepted, started, packet("alive"), done]

    with FakeDaemon(answer) as daemon:
        assert run(daemon, "tc", "PING") == 0
    lines = capsys.readouterr().out.splitlines()
    words = [line.split(" s  ")[-1].strip() for line in lines]
    assert words == [
        "acceptance success",
        "start success",
        "alive",
        "completion success",
        "completed",
    ]


def test_what_others_do_is_not_shown(capsys):
    def answer(tc):
        other = bytearray(tc)
        other[3] ^= 1
        return [report("acceptance_failure", bytes(other), error=6), *completed(tc)]

    with FakeDaemon(answer) as daemon:
        assert run(daemon, "tc", "PING") == 0
    assert "failure" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("reports", "code", "words"),
    [
        (["acceptance_failure"], 3, "acceptance failure: OUT_OF_RANGE, argument 2, 7"),
        (["routing_failure"], 3, "routing failure: OUT_OF_RANGE"),
        (["acceptance_success", "start_failure"], 4, "start failure: OUT_OF_RANGE"),
        (["acceptance_success", "progress_failure"], 4, "progress failure"),
        (["acceptance_success", "completion_failure"], 4, "completion failure: OUT_OF_RANGE"),
        (["acceptance_success"], 5, "accepted, not finished in time"),
        ([], 5, "no answer"),
    ],
)
def test_exit_codes_tell_what_became_of_a_command(capsys, reports, code, words):
    failure = {"error": 7, "error_argument": 2, "error_value": 7.0}

    def answer(tc):
        return [report(name, tc, **(failure if "failure" in name else {})) for name in reports]

    with FakeDaemon(answer) as daemon:
        assert run(daemon, "tc", "PING", "--timeout", "0.5") == code
    assert words in capsys.readouterr().out


def test_a_set_that_is_asked_for_is_shown(capsys):
    def answer(tc):
        accepted, started, done = completed(tc)
        return [accepted, started, packet("health", mode=3), packet("link"), done]

    with FakeDaemon(answer) as daemon:
        assert run(daemon, "tc", "REPORT_SET", "sid=HEALTH", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert [item["packet"] for item in found["answers"]] == ["health"]
    assert found["answers"][0]["values"]["mode"] == "IDENTIFY"


def test_a_wrong_command_line_sends_nothing(capsys):
    with FakeDaemon() as daemon:
        assert run(daemon, "tc", "SET_MODE", "mode=BOOT") == 2
        assert run(daemon, "tc", "NONSENSE") == 2
    assert daemon.received == b""
    assert "SAFE" in capsys.readouterr().err


def test_without_a_daemon_there_is_no_link(capsys):
    with FakeDaemon() as daemon:
        pass
    assert run(daemon, "tc", "PING") == 1
    assert "ground: 127.0.0.1" in capsys.readouterr().err


def test_rubbish_instead_of_telemetry_is_told(capsys):
    with FakeDaemon(lambda _tc: [b"\xff" * 100]) as daemon:
        assert run(daemon, "tc", "PING") == 1
    assert "not a telemetry packet" in capsys.readouterr().err


def test_telemetry_is_shown_packet_by_packet(capsys, tmp_path):
    stream = packet("health", met_s=7.5, mode=3, ticks=12) + packet("link") + packet("time")
    raw = tmp_path / "raw"
    with FakeDaemon(stream=lambda: stream) as daemon:
        words = ("tm", "health", "--field", "mode", "--field", "ticks", "--count", "2")
        assert run(daemon, *words, "--raw", str(raw)) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines == ["7.500 s  health  mode=IDENTIFY  ticks=12"] * 2
    assert raw.read_bytes()[: len(stream)] == stream


def test_too_little_telemetry_is_told(capsys):
    with FakeDaemon() as daemon:
        assert run(daemon, "tm", "--count", "1", "--seconds", "0.2") == 1
    assert "0 of 1" in capsys.readouterr().err


def test_commands_are_listed_with_their_arguments(capsys):
    assert main(["list"]) == 0
    assert "RUN_BATCH" in capsys.readouterr().out
    assert main(["list", "set_parameters"]) == 0
    together = capsys.readouterr().out
    assert "all or none" in together
    assert "  batch_last_s: " in together, "docs/ground.md sets it"
    assert "MODE" not in together, "SET_MODE sets no parameter"
    assert main(["list", "RUN_BATCH"]) == 0
    text = capsys.readouterr().out
    assert "method: one of MRNEA, RDA, CM, CE, FUSED" in text
    assert "last_s: float 0 to 1e+06" in text


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (("heath",), "heath: no such packet; did you mean health"),
        (("estimate", "--field", "target_mas_kg"), "did you mean target_mass_kg"),
        (("health", "--field", "target_mass_kg"), "target_mass_kg: no such field"),
        (("--field", "nowhere_at_all"), "nowhere_at_all: no such field"),
    ],
)
def test_a_misspelt_packet_or_field_ends_at_once(capsys, words, hint):
    assert main(["--port", "1", "tm", *words]) == 2
    assert hint in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        ("tm", "--seconds", "nan"),
        ("tm", "--seconds", "inf"),
        ("tm", "--count", "0"),
        ("tc", "PING", "--timeout", "-1"),
        ("tc", "PING", "--at", "inf"),
        ("tc", "PING", "--at", "nan"),
        ("--port", "70000", "tc", "PING"),
        ("serve", "--http-port", "-1"),
        ("file", "--timeout", "0", "list", "files"),
    ],
)
def test_numbers_of_the_command_line_are_checked(capsys, words):
    with pytest.raises(SystemExit) as caught:
        main(list(words))
    assert caught.value.code == 2
    assert "must be" in capsys.readouterr().err


def test_packets_outside_the_dictionary_are_shown_raw_and_counted(capsys):
    stream = b"".join((*OUTSIDE, packet("health", met_s=7.5, mode=3)))
    with FakeDaemon(stream=lambda: stream) as daemon:
        assert run(daemon, "tm", "--count", str(2 * len(OUTSIDE) + 2)) == 0
    shown = capsys.readouterr()
    lines = shown.out.splitlines()
    raw = [line for line in lines if line.startswith("unknown")]
    assert len(raw) == 2 * len(OUTSIDE)
    assert all(f"raw={item[:64].hex()}" in line for item, line in zip(OUTSIDE, raw, strict=False))
    assert f"{2 * len(OUTSIDE)} packets are not in the dictionary" in shown.err
    assert sum("health" in line for line in lines) == 2


def test_a_packet_outside_the_dictionary_does_not_disturb_a_command(capsys):
    def answer(tc):
        accepted, started, done = completed(tc)
        return [accepted, OUTSIDE[0], started, done]

    with FakeDaemon(answer) as daemon:
        assert run(daemon, "tc", "PING") == 0
    assert "unknown" not in capsys.readouterr().out


def test_every_command_that_was_sent_is_in_the_history(capsys, home):
    with FakeDaemon() as daemon:
        assert run(daemon, "tc", "PING") == 0
        assert run(daemon, "tc", "ENABLE_SET", "sid=HEALTH") == 0
    with FakeDaemon(lambda _tc: []) as daemon:
        assert run(daemon, "tc", "PING", "--timeout", "0.2") == 5
    capsys.readouterr()
    with (home / ".local/state/ground/commands.jsonl").open("a") as file:
        file.write("{cut")
    assert main(["history", "--count", "2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("ENABLE_SET sid=HEALTH: completed")
    assert lines[1].endswith("PING: no answer")
    assert main(["history", "--json"]) == 0
    first = json.loads(capsys.readouterr().out.splitlines()[0])
    assert (first["command"], first["outcome"], first["via"]) == ("PING", "completed", "tc")
    assert first["target"].startswith("127.0.0.1:")
    assert (home / ".local/state/ground/commands.jsonl").stat().st_mode & 0o077 == 0
    assert (home / ".local/state/ground").stat().st_mode & 0o077 == 0


def test_a_folder_that_cannot_be_made_is_one_line(capsys, home):
    (home / "file").touch()
    assert main(["--state", str(home / "file/state"), "file", "get", "files/a", "a"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "file/state: Not a directory" in said
