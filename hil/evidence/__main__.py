"""Figures about the project itself: `python -m hil.evidence house`, `... walks`."""

from __future__ import annotations

import argparse
import sys


def main(argv: list[str] | None = None) -> int:
    """Run one subcommand and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m hil.evidence", description=__doc__)
    parser.add_argument("figures", choices=("house", "walks"))
    if parser.parse_args(argv).figures == "walks":
        from hil.evidence import walks

        return walks.main()
    from hil.evidence import house

    return house.main()


if __name__ == "__main__":
    sys.exit(main())
