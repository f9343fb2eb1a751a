"""Mistakes of a first try, rows of docs/howto/when_wrong.md: one line with cause and cure."""

import re

import pytest

from fsw.__main__ import main
from tests.support.first_mistakes import MADE
from tests.support.when_wrong import ROWS

OWN = {mistake: own for mistake, *own in ROWS}


@pytest.mark.parametrize("mistake", MADE)
def test_a_mistake_is_one_line_with_cause_and_cure(mistake, arm, capsys):
    command, words = OWN[mistake]
    typed = MADE[mistake](arm)
    assert command.split()[:2] == ["fsw", typed[0]]
    assert main(typed) in (1, 2)
    lines = [
        line
        for line in capsys.readouterr().err.splitlines()
        if not line.startswith(f"fsw: {typed[0]}: ")  # what it is doing
    ]
    assert len(lines) == 1, lines
    assert words in lines[0]
    assert not re.search(r"Traceback|Errno|Error:|NoneType|<class", lines[0])
