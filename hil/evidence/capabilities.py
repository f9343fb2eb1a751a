"""Compare what a user can do at a commit and today: `python -m hil.evidence capabilities COMMIT`.

`names` runs in a separate process on the checkout of the commit and on today's checkout. It lists
the commands, the keys of the configuration, the telemetry dictionary and the scenarios.
"""

import argparse
import importlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

ROOT = Path(__file__).parents[2]


def main(commit: str, root: Path = ROOT) -> int:
    """Print by kind, as JSON, the counts at the commit and today, and the lost names; return 0."""
    with TemporaryDirectory() as folder:
        archive = subprocess.run(
            ["git", "archive", commit], cwd=root, check=True, stdout=subprocess.PIPE
        )
        subprocess.run(["tar", "-x", "-C", folder], input=archive.stdout, check=True)
        before, after = asked(Path(folder)), asked(root)
    table = {
        kind: {
            "before": len(before[kind]),
            "after": len(names),
            "vanished": sorted(set(before[kind]) - set(names)),
        }
        for kind, names in after.items()
    }
    sys.stdout.write(json.dumps(table, indent=1) + "\n")
    return 0


def asked(checkout: Path) -> dict[str, list[str]]:
    """Return the names by kind, as `names` lists them in a new process on a checkout."""
    call = [sys.executable, "-P", __file__]
    environment = os.environ | {"PYTHONPATH": str(checkout)}
    run = subprocess.run(
        call, cwd=checkout, env=environment, check=True, stdout=subprocess.PIPE, text=True
    )
    listed: dict[str, list[str]] = json.loads(run.stdout)
    return listed


def names() -> dict[str, list[str]]:
    """Return by kind the names of commands, options, keys, telemetry items and scenarios."""
    from fsw.config.whole import Config
    from fsw.telemetry.dictionary import DICTIONARY

    commands = []
    for package in ("fsw", "hil", "ground"):
        module = importlib.import_module(f"{package}.__main__")
        make = getattr(module, "parser", None) or module._parser  # noqa: SLF001 - its name before
        commands += list(options(make(), package))
    schema = Config.model_json_schema()
    return {
        "commands and options": commands,
        "keys": sorted(set(keys(schema, schema["$defs"]))),
        "telecommands": [item.name for item in DICTIONARY.telecommands],
        "packets": [item.name for item in DICTIONARY.packets],
        "events": [item.code for item in DICTIONARY.events],
        "scenarios": sorted(path.stem for path in Path("hil/scenarios").glob("*.yaml")),
    }


def options(parser: argparse.ArgumentParser, path: str) -> Iterator[str]:
    """Yield a command, each of its arguments, and the arguments of its subcommands."""
    yield path
    for action in parser._actions:  # noqa: SLF001 - argparse lists them nowhere else
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for name, child in action.choices.items():
                yield from options(child, f"{path} {name}")
        else:
            yield f"{path} {'/'.join(action.option_strings) or action.dest}"


def keys(schema: Mapping[str, Any], models: Mapping[str, Any], path: str = "") -> Iterator[str]:
    """Yield the dotted name of every key of a JSON schema; `*` stands for a name of the user."""
    if "$ref" in schema:
        schema = models[schema["$ref"].rpartition("/")[2]]
    for form in (*schema.get("anyOf", ()), *schema.get("oneOf", ()), schema.get("items")):
        if form:
            yield from keys(form, models, path)
    for name, value in schema.get("properties", {}).items():
        yield f"{path}{name}"
        yield from keys(value, models, f"{path}{name}.")
    free = [*schema.get("patternProperties", {}).values(), schema.get("additionalProperties")]
    for value in free:  # values of a mapping whose keys the user names
        if isinstance(value, dict):
            yield from keys(value, models, f"{path}*.")


if __name__ == "__main__":
    sys.stdout.write(json.dumps(names()))
