"""The names of what a user can do, on a small parser and a small schema."""

import argparse

from hil.evidence.capabilities import keys, options


def test_options_of_subcommands_are_listed() -> None:
    program = argparse.ArgumentParser(prog="p", add_help=False)
    commands = program.add_subparsers()
    commands.add_parser("run", add_help=False).add_argument("--fast", action="store_true")
    assert list(options(program, "p")) == ["p", "p run", "p run --fast"]


def test_keys_go_through_references_lists_unions_and_free_names() -> None:
    models = {"Body": {"properties": {"mass_kg": {}}}}
    body = {"$ref": "#/$defs/Body"}
    schema = {
        "properties": {
            "one": {"anyOf": [body, {"type": "null"}]},
            "list": {"items": body},
            "free": {"patternProperties": {"^x$": body}},
            "any": {"additionalProperties": body},
        }
    }
    found = ["one", "one.mass_kg", "list", "list.mass_kg"]
    found += ["free", "free.*.mass_kg", "any", "any.*.mass_kg"]
    assert list(keys(schema, models)) == found
