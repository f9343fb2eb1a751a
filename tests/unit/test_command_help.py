"""Help of every command: an example that its parser accepts, and completion of the shell."""

import re
import shlex
import subprocess

import pytest
import shtab

from tests.support.commands import PROGRAMS, command_line_fault, leaves, parser_of

COMMANDS = {leaf.prog: leaf for program in PROGRAMS for leaf in leaves(parser_of(program))}


def test_there_are_commands_at_every_depth():
    assert {"fsw run", "hil study methods", "ground file get"} <= set(COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_of_every_command_has_an_example_that_it_accepts(name):
    epilog = COMMANDS[name].epilog or ""
    assert re.match(r"examples?: ", epilog), f"{name} --help has no example"
    lines = re.split(r"; (?:then )?", epilog.split(": ", 1)[1])
    for line in lines:
        assert command_line_fault(line) == ""
    own = [word for word in shlex.split(lines[0]) if not word.startswith("-")]
    assert set(name.split()) <= set(own), "an example of another command"


def test_a_wrong_command_line_is_found():
    assert "unrecognized arguments: --swift" in command_line_fault("fsw run robot.yaml --swift")
    assert "required" in command_line_fault("fsw identify --config robot.yaml")


@pytest.mark.parametrize("program", PROGRAMS)
@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_completion_of_a_shell_knows_every_command(program, shell):
    script = shtab.complete(parser_of(program), shell=shell)
    own = [name.split()[1] for name in COMMANDS if name.startswith(f"{program} ")]
    assert own
    assert all(name in script for name in own)


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("fsw re", {"replay", "report"}),
        ("hil study p", {"paper"}),
        ("ground file re", {"resume", "rename"}),
    ],
)
def test_bash_completes_commands(typed, offered, tmp_path):
    program, *words = typed.split()
    script = tmp_path / program
    script.write_text(shtab.complete(parser_of(program), shell="bash"))
    asked = (
        f"source {script}; f=$(complete -p {program} | sed 's/.*-F \\([^ ]*\\).*/\\1/');"
        f"COMP_WORDS=({typed}); COMP_CWORD={len(words)}; COMP_LINE='{typed}';"
        f"$f {program} '{words[-1]}' '{(program, *words)[-2]}'; echo ${{COMPREPLY[@]}}"
    )
    done = subprocess.run(["bash", "-c", asked], capture_output=True, text=True, check=False)
    assert set(done.stdout.split()) == offered, done.stderr
