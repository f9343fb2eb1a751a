"""Commands that name their function: every option is one of its parameters."""

import argparse
import inspect
from importlib import import_module

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


@pytest.mark.parametrize("name", NAMED)
def test_a_function_takes_what_its_command_offers(name):
    parser = NAMED[name]
    module, function = parser.get_default("function").split(":")
    signature = inspect.signature(getattr(import_module(module), function))
    offered = {action.dest for action in parser._actions} - {"help"}
    signature.bind(**dict.fromkeys(offered))
    assert offered == set(signature.parameters)
