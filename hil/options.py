"""Types of command-line options, and the call of a command's function."""

import argparse
from collections.abc import Callable
from importlib import import_module
from pathlib import Path


def count(text: str) -> int:
    """Return a count of at least 1; argparse reports an invalid count with its option."""
    number = int(text) if text.isdecimal() else 0
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text}: must be a whole number of at least 1")
    return number


def seed(text: str) -> int:
    """Return a seed of at least 0; argparse reports an invalid seed with its option."""
    return count_or_none(text)


def count_or_none(text: str) -> int:
    """Return a count of at least 0; argparse reports an invalid count with its option."""
    if not (text.isascii() and text.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text}: must be a whole number of at least 0")
    return int(text)


def add_own(parser: argparse.ArgumentParser) -> None:
    """Add the options of a run with a configuration in which not everything is exact."""
    which = parser.add_mutually_exclusive_group()
    which.add_argument(
        "--doubts",
        action="store_true",
        help="fly the scenario's configuration with the default doubts of arm, sensors and"
        " mounting, and errors of the world drawn from them; nothing is declared exact",
    )
    which.add_argument(
        "--config",
        type=Path,
        metavar="YAML",
        help="fly this configuration of the flight software; the world's devices are as it says,"
        " with errors drawn from its sigmas",
    )
    parser.add_argument(
        "--devices",
        type=Path,
        metavar="YAML",
        help="with --config: devices as this other configuration says, to plant a mistake",
    )


def require_own(arguments: argparse.Namespace) -> None:
    """Raise ScenarioError for options that mean nothing with, or without, `--config`."""
    from hil.world.scenario import ScenarioError

    if arguments.config is None:
        if arguments.devices is not None:
            raise ScenarioError("--devices: needs --config, the configuration that flies")
        return
    for setting in arguments.settings:
        if setting.startswith("flight."):
            raise ScenarioError(f"--set {setting}: --config is given; set it in {arguments.config}")


def call(arguments: argparse.Namespace) -> int:
    """Call the function that a command names, with its options as keywords; return the exit code.

    A command with the key `command` gets the whole namespace instead. The module of a function is
    imported when the function is called, so that the help imports none.
    """
    given = vars(arguments)
    if "command" in given:
        command: Callable[[argparse.Namespace], int] = given["command"]
        return command(arguments)
    module, name = given.pop("function").split(":")
    return int(getattr(import_module(module), name)(**given))
