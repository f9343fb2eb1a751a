"""One short motion in virtual time for every test of the commands that read a recording."""

from tests.support.command_fixtures import flown, rehearsed_once

__all__ = ["flown", "rehearsed_once"]
