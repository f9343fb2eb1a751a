"""Text from the daemon does nothing to the operator's terminal."""

import pytest

from ground.telemetry import TelemetryDecoder, shown
from tests.support.fake_daemon import packet


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("plain text, 5 %", "plain text, 5 %"),
        ("grün", "grün"),
        ("\x1b[2Jgone", r"\x1b[2Jgone"),
        ("a\u202egpj.exe", r"a\u202egpj.exe"),
        ("two\nlines", r"two\nlines"),
    ],
)
def test_only_what_a_terminal_can_show_is_shown(text: str, line: str):
    assert shown(text) == line


def test_names_in_telemetry_are_shown_so():
    sample = TelemetryDecoder().decode(packet("file_attributes", path="\x1b[2J"))
    assert sample.values["path"] == r"\x1b[2J"
