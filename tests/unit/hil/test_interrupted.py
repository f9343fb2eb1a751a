"""An interrupted command says that it can be resumed only where it can."""

import pytest

from hil.errors import SETTINGS, explained


def interrupted() -> int:
    raise KeyboardInterrupt


@pytest.mark.parametrize("resumes", [True, False])
def test_only_a_folder_that_continues_is_named(tmp_path, capsys, resumes):
    if resumes:
        (tmp_path / SETTINGS).write_text("{}")
    assert explained(interrupted, 2, 1, tmp_path) == 130
    words = f"; the same command continues from {tmp_path}" if resumes else ""
    assert capsys.readouterr().err == f"hil: interrupted{words}\n"


def test_a_command_without_a_folder_only_ends(capsys):
    assert explained(interrupted, 2, 1) == 130
    assert capsys.readouterr().err == "hil: interrupted\n"
