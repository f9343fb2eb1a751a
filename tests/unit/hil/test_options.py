"""Commands that name their function: every option is one of its parameters."""

import argparse
import inspect
from importlib import import_module
from typing import get_args

import pytest

from hil.options import call
from tests.support.commands import leaves, parser_of

NAMED = {
    leaf.prog: leaf for leaf in leaves(parser_of("hil")) if leaf.get_default("function") is not None
}


def taken(seconds: float, words: list[str]) -> int:
    assert words == ["a"]
    return int(seconds)


def test_a_function_gets_its_options_by_name_and_returns_the_exit_code():
    function = f"{__name__}:taken"
    assert call(argparse.Namespace(function=function, seconds=3.0, words=["a"])) == 3
    assert call(argparse.Namespace(command=lambda given: given.code, code=4)) == 4


def test_there_are_commands_that_name_their_function():
    assert {"hil faults", "hil vcan", "hil study paper", "hil hardware"} <= set(NAMED)


def accepted(signature: inspect.Signature) -> set[str]:
    """Return the names of the options; those of a TypedDict in place of `**`."""
    names: set[str] = set()
    for parameter in signature.parameters.values():
        kinds = get_args(parameter.annotation) if parameter.kind is parameter.VAR_KEYWORD else ()
        names |= set(kinds[0].__annotations__) if kinds else {parameter.name}
    return names


@pytest.mark.parametrize("name", NAMED)
def test_a_function_takes_what_its_command_offers(name):
    parser = NAMED[name]
    module, function = parser.get_default("function").split(":")
    signature = inspect.signature(getattr(import_module(module), function))
    offered = {action.dest for action in parser._actions} - {"help"}
    signature.bind(**dict.fromkeys(offered))
    assert offered == accepted(signature)


SEEDED = {
    (leaf.prog, option): leaf
    for leaf in leaves(parser_of("hil"))
    for option in ("--first", "--seed")
    if option in leaf._option_string_actions
}


@pytest.mark.parametrize("given", SEEDED, ids=" ".join)
def test_a_seed_is_checked_by_every_command_that_takes_one(given):
    action = SEEDED[given]._option_string_actions[given[1]]
    for text in ("-1", "1.5", "x", ""):
        with pytest.raises(argparse.ArgumentTypeError, match="at least 0"):
            action.type(text)
    assert action.type("7") == 7


def test_a_negative_first_seed_ends_with_2_and_the_name_of_the_option(capsys):
    for command in (["study", "effects", "base"], ["seeds", "base"], ["calibration"]):
        with pytest.raises(SystemExit) as left:
            parser_of("hil").parse_args([*command, "--first", "-1"])
        assert left.value.code == 2
        assert "--first: -1: must be a whole number of at least 0" in capsys.readouterr().err


COUNTED = {
    (leaf.prog, option): leaf
    for leaf in leaves(parser_of("hil"))
    for option in ("--seeds", "--device-seeds", "--count", "--jobs")
    if option in leaf._option_string_actions
}
MAY_BE_NONE = {("hil study methods", "--device-seeds"), ("hil study paper", "--device-seeds")}
MAY_BE_NONE |= {("hil vs-basilisk", "--seeds")}


@pytest.mark.parametrize("given", COUNTED, ids=" ".join)
def test_a_count_is_checked_by_every_command_that_takes_one(given, capsys):
    parser, option = COUNTED[given], given[1]
    action = parser._option_string_actions[option]
    wrong = ["-1", "1.5", "x", ""] if given in MAY_BE_NONE else ["-1", "0", "1.5", "x", ""]
    for text in wrong:
        with pytest.raises(SystemExit) as left:
            parser.parse_args([option, text])
        assert left.value.code == 2
        assert f"{option}: {text}: must be a whole number of at least" in capsys.readouterr().err
    assert action.type("7") == 7
