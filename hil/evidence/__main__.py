"""Figures about the project itself: `python -m hil.evidence house`."""

from __future__ import annotations

import argparse
import sys

from hil.evidence import house


def main(argv: list[str] | None = None) -> int:
    """Run one subcommand and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m hil.evidence", description=__doc__)
    parser.add_argument("figures", choices=("house",))
    parser.parse_args(argv)
    return house.main()


if __name__ == "__main__":
    sys.exit(main())
