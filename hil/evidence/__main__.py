"""Figures about the project itself: `python -m hil.evidence house`, `... walks`, and others.

`capabilities COMMIT` lists what a user could do at a commit and cannot do today.
"""

import argparse
import importlib
import sys


def main(argv: list[str] | None = None) -> int:
    """Run one subcommand and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m hil.evidence", description=__doc__)
    kinds = parser.add_subparsers(required=True, dest="figures")
    kinds.add_parser("house")
    kinds.add_parser("walks")
    kinds.add_parser("capabilities").add_argument("commit")
    given = vars(parser.parse_args(argv))
    return int(importlib.import_module(f"hil.evidence.{given.pop('figures')}").main(**given))


if __name__ == "__main__":
    sys.exit(main())
