"""No command overwrites what `--out` names, unless it is told to."""

import pytest

import hil.__main__
from fsw.__main__ import main, parser
from tests.support.commands import leaves

COMMANDS = {
    "init": "arm.urdf --out",
    "excite": "{config} --limits x.yaml --out",
    "report": "x.mcap --out",
    "view": "x.mcap --out",
    "identify": "x.mcap --report",
    "import": "x.csv --map m.yaml --config c.yaml --out",
    "calibrate": "rest x.mcap --config c.yaml --out",
    "export": "result.json --out",
}


def test_every_command_that_writes_is_tried():
    writing = {leaf.prog.split()[1] for leaf in leaves(parser()) if "--force" in leaf.format_help()}
    named = {leaf.prog.split()[1] for leaf in leaves(parser()) if "--out " in leaf.format_help()}
    assert writing == set(COMMANDS) >= named


@pytest.mark.parametrize("name", COMMANDS)
def test_what_is_there_is_not_overwritten(name, arm, tmp_path, capsys):
    there = tmp_path / "there"
    there.write_text("kept")
    words = COMMANDS[name].format(config=arm.write()).split()
    assert main([name, *words, str(there)]) == 2
    assert "there exists; --force overwrites it" in capsys.readouterr().err
    assert there.read_text() == "kept"
    main([name, *words, str(there), "--force"])
    assert "--force overwrites" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("--out there --report new.html", "there exists; --force overwrites it"),
        ("--out no/result.json", "the folder no is missing; create it first"),
        ("--report no/page.html", "the folder no is missing; create it first"),
        ("--out page --report page", "page: named by two options"),
    ],
)
def test_outputs_of_identify_are_judged_before_it_works(
    words, reason, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there").write_text("kept")
    assert main(["identify", "x.mcap", *words.split()]) == 2
    assert reason in capsys.readouterr().err


def test_a_flight_is_not_overwritten(tmp_path, capsys):
    (tmp_path / "result.json").touch()
    assert hil.__main__.main(["run", "target_leo", "--out", str(tmp_path)]) == 2
    assert "exists; --force overwrites it" in capsys.readouterr().err


def test_a_file_that_fails_is_no_mistake_of_the_configuration(monkeypatch, capsys):
    """The service is started again after every exit but 2."""

    def fails(_arguments):
        raise OSError(28, "No space left on device", "state/blocks.bin")

    monkeypatch.setattr("fsw.__main__._run", fails)
    assert main(["run", "robot.yaml"]) == 1
    assert capsys.readouterr().err == "fsw: state/blocks.bin: No space left on device\n"
